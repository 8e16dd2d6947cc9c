// SPDX-License-Identifier: Apache-2.0
#include "seen_actors.hpp"

#include <relidar/simulate/actor_boxes.hpp>

namespace relidar::scan_files {
namespace {

constexpr double kVelocityStep_s = 0.005;

class SampledScanRays {
public:
    explicit SampledScanRays(const RenderedScan& scan) : scan_(scan) {
        constexpr std::size_t kMaxSampledRays = 4096;
        // Uses every `step`-th ray. The step is odd, because an even step may divide the
        // number of columns. Every row would then contribute the same columns.
        const std::size_t n = scan.image.direction.size(), step = (n / kMaxSampledRays) | 1;
        for (std::size_t i = 0; i < n; i += step)
            rays_.push_back({scan.image.direction[i], scan.time_offset_s[i]});
    }
    /// Returns the firing time of the ray that passes closest to a moving point.
    /// @param get_position_m position at a time, in the world frame of the dataset
    template <class PositionFunction>
    double time_towards(const PositionFunction& get_position_m) const {
        // Number of fixed-point iterations. Each computes the direction from the sensor
        // to the point at `time_s`, and sets `time_s` to the firing time of the ray
        // closest to this direction.
        constexpr int kTimeIterations = 3;
        double time_s = scan_.time_s;
        for (int round = 0; round < kTimeIterations && !rays_.empty(); ++round) {
            const glm::vec3 towards(
                glm::normalize(inverse(sensor_pose_at(scan_, time_s)) * get_position_m(time_s)));
            const auto cosine = [&](const SampledRay& ray) { return glm::dot(ray.direction, towards); };
            time_s = scan_.time_s + double(std::ranges::max_element(rays_, {}, cosine)->time_offset_s);
        }
        return time_s;
    }

private:
    struct SampledRay {
        glm::vec3 direction;
        float time_offset_s;
    };
    const RenderedScan& scan_;
    std::vector<SampledRay> rays_;
};

/// Returns the firing times of the first returns of a scan on an actor.
std::vector<float> times_on_actor(const RenderedScan& scan, const ScanOutputOptions& format,
                                  const std::string& track) {
    const auto name = std::ranges::find(format.instance_names, track);
    if (name == format.instance_names.end()) return {};
    const auto instance = name - format.instance_names.begin();
    const std::vector<float>& range_m = point_ranges(scan, format.config);
    std::vector<float> times_s;
    for (std::size_t i = 0; i < range_m.size(); ++i)
        if (scan.instance[i] == instance && is_ray_returned(scan.image.drop_prob[i], range_m[i]))
            times_s.push_back(scan.time_offset_s[i]);
    return times_s;
}

/// Returns the time of a box. The start and the end of a sweep hit different parts of a
/// box behind the sensor. Such a box gets the median time of its returns, to match the
/// larger part.
/// @param faced_s  time at which the sensor points at the centre of the box
double choose_box_time(const RenderedScan& scan, double faced_s, std::vector<float> times_s) {
    // A box takes a smaller share of a sweep, unless it is hit at its start and end.
    constexpr double kMostOfSweep = 0.5;
    if (times_s.empty()) return faced_s;
    const auto [first_s, last_s] = std::ranges::minmax(scan.time_offset_s);
    const auto [first_return_s, last_return_s] = std::ranges::minmax(times_s);
    if (double(last_return_s) - double(first_return_s) < kMostOfSweep * (double(last_s) - double(first_s)))
        return faced_s;
    const auto middle = times_s.begin() + std::ptrdiff_t(times_s.size() / 2);
    std::ranges::nth_element(times_s, middle);  // not the mean of two, which no part has
    return scan.time_s + double(*middle);
}

}  // namespace

Pose sensor_pose_at(const RenderedScan& scan, double time_s) {
    return scan.track.pose.empty() ? scan.world_from_sensor : scan.track.pose_at(time_s);
}

Velocity object_velocity(const std::function<Pose(double)>& get_world_from_object, double time_s) {
    const Twist twist = compute_twist(get_world_from_object(time_s - kVelocityStep_s),
                                      get_world_from_object(time_s + kVelocityStep_s));
    const glm::dquat thing_from_world = glm::conjugate(get_world_from_object(time_s).rotation);
    const double span_s = 2.0 * kVelocityStep_s;
    return {thing_from_world * glm::dvec3(twist[0], twist[1], twist[2]) / span_s,
            thing_from_world * glm::dvec3(twist[3], twist[4], twist[5]) / span_s};
}

std::vector<ActorInScan> find_actors(const RenderedScan& scan, const ScanOutputOptions& format) {
    const SampledScanRays rays(scan);
    std::vector<ActorInScan> actors;
    for (const BoxTrack& box : format.actors) {
        const auto view = std::ranges::find(scan.actor_views, box.id, &ActorVisibility::track);
        std::optional<double> visible_share;
        if (view != scan.actor_views.end())
            visible_share = std::min(1.0, double(view->n_rays) / double(view->n_rays_alone));
        if (!visible_share && !box.is_observed(scan.time_s)) continue;
        const auto world_from_box = [&box, &format](double t_s) {
            const Pose pose = box.world_from_box.pose_at(t_s);
            return Pose{pose.rotation, pose.translation + format.world_offset_m};
        };
        const double faced_s = rays.time_towards([&](double t_s) { return world_from_box(t_s).translation; });
        const std::vector<float> times_s = times_on_actor(scan, format, box.id);
        actors.push_back(
            {&box, world_from_box, choose_box_time(scan, faced_s, times_s), times_s.size(), visible_share});
    }
    return actors;
}

}  // namespace relidar::scan_files

namespace relidar {

std::vector<ActorBox> actor_boxes_of(const RenderedScan& scan, const ScanOutputOptions& format) {
    std::vector<ActorBox> boxes;
    if (scan.actor_views.empty()) return boxes;
    for (const scan_files::ActorInScan& actor : scan_files::find_actors(scan, format)) {
        if (!actor.visible_share) continue;
        const Pose pose = actor.world_from_box(actor.faced_s);
        const glm::dvec3 velocity_mps =
            pose.rotation * scan_files::object_velocity(actor.world_from_box, actor.faced_s).linear_mps;
        boxes.push_back({actor.box->id, actor.box->category, actor.box->size_m, actor.faced_s, pose,
                         velocity_mps, actor.n_points, *actor.visible_share});
    }
    return boxes;
}

void move_actor_boxes(ScanOutputOptions& options, const ActorTracksByName& dataset_from_actor) {
    std::erase_if(options.actors, [&](BoxTrack& box) {
        const auto poses = dataset_from_actor.find(box.id);
        if (poses == dataset_from_actor.end()) return true;
        box.world_from_box = shift_track(poses->second, -options.world_offset_m);
        return false;
    });
}

}  // namespace relidar
