// SPDX-License-Identifier: Apache-2.0
#include "simulate/scan_files/seen_actors.hpp"

#include <relidar/scene/labels.hpp>
#include <relidar/simulate/actor_boxes.hpp>

namespace relidar::scan_files {
namespace {

constexpr double kVelocityStep_s = 0.005;

struct SampledRay {
    glm::vec3 direction;
    float time_offset_s;
};

std::vector<SampledRay> sample_rays(const RenderedScan& scan) {
    constexpr std::size_t kMaxSampledRays = 4096;
    // Uses every `step`-th ray. The step is odd, because an even step may divide the
    // number of columns. Every row would then contribute the same columns.
    const std::size_t n = scan.image.direction.size(), step = (n / kMaxSampledRays) | 1;
    std::vector<SampledRay> rays;
    for (std::size_t i = 0; i < n; i += step)
        rays.push_back({scan.image.direction[i], scan.time_offset_s[i]});
    return rays;
}

/// Returns the firing time of the ray that passes closest to a moving object. Each
/// iteration computes the direction from the sensor to the object at `time_s`, and sets
/// `time_s` to the firing time of the ray closest to this direction.
double time_towards(const RenderedScan& scan, const std::vector<SampledRay>& rays,
                    const std::function<Pose(double)>& world_from_object) {
    constexpr int kIterations = 3;
    double time_s = scan.time_s;
    for (int round = 0; round < kIterations && !rays.empty(); ++round) {
        const Pose sensor_from_world = inverse(sensor_pose_at(scan, time_s));
        const glm::vec3 towards(glm::normalize(sensor_from_world * world_from_object(time_s).translation));
        const auto cosine = [&](const SampledRay& ray) { return glm::dot(ray.direction, towards); };
        time_s = scan.time_s + double(std::ranges::max_element(rays, {}, cosine)->time_offset_s);
    }
    return time_s;
}

/// Returns the rays of a scan whose first return is on an instance (0: the background).
std::vector<std::size_t> rays_on(const RenderedScan& scan, const ScanOutputOptions& format,
                                 std::ptrdiff_t instance) {
    const std::vector<float>& range_m = point_ranges(scan, format.config);
    std::vector<std::size_t> rays;
    for (std::size_t i = 0; i < range_m.size(); ++i)
        if (scan.instance[i] == instance && is_ray_returned(scan.image.drop_prob[i], range_m[i]))
            rays.push_back(i);
    return rays;
}

/// Returns the firing times of the first returns of a scan on an actor.
std::vector<float> times_on_actor(const RenderedScan& scan, const ScanOutputOptions& format,
                                  const std::string& track) {
    const auto name = std::ranges::find(format.instance_names, track);
    if (name == format.instance_names.end()) return {};
    std::vector<float> times_s;
    for (const std::size_t ray : rays_on(scan, format, name - format.instance_names.begin()))
        times_s.push_back(scan.time_offset_s[ray]);
    return times_s;
}

struct BackgroundPoint {
    glm::dvec3 world_m;  ///< in relidar's world frame
    float time_offset_s;
};

/// Returns the first returns of a scan on the background.
std::vector<BackgroundPoint> background_points(const RenderedScan& scan, const ScanOutputOptions& format) {
    const std::vector<float>& range_m = point_ranges(scan, format.config);
    const Pose world_from_dataset{{1, 0, 0, 0}, -format.world_offset_m};
    FiringPoseInterpolator world_from_firing(scan, world_from_dataset);
    std::vector<BackgroundPoint> points;
    for (const std::size_t ray : rays_on(scan, format, /*instance=*/0)) {
        const glm::vec3 in_sensor_m = scan.image.origin[ray] + range_m[ray] * scan.image.direction[ray];
        points.push_back({world_from_firing.pose_of(ray) * glm::dvec3(in_sensor_m), scan.time_offset_s[ray]});
    }
    return points;
}

/// Returns the firing times of the points that belong to a standing object.
std::vector<float> times_in_box(const std::vector<BackgroundPoint>& points, const Pose& world_from_box,
                                const glm::dvec3& size_m) {
    const Pose box_from_world = inverse(world_from_box);
    // The sphere of this radius contains the box with its margin: 2 is above sqrt(3). The
    // test of the sphere is faster than is_on_object().
    const double radius_m = 0.5 * glm::length(size_m) + 2.0 * kObjectMargin_m;
    std::vector<float> times_s;
    for (const BackgroundPoint& point : points)
        if (glm::distance(point.world_m, world_from_box.translation) < radius_m &&
            is_on_object(box_from_world * point.world_m, size_m))
            times_s.push_back(point.time_offset_s);
    return times_s;
}

/// Returns the counted rays of an object. Null if none would hit it or were counted.
const ActorVisibility* find_view(const RenderedScan& scan, const std::string& track) {
    const auto view = std::ranges::find(scan.actor_views, track, &ActorVisibility::track);
    return view == scan.actor_views.end() ? nullptr : &*view;
}

std::optional<double> visible_share(const ActorVisibility* view) {
    if (!view) return {};
    if (view->n_rays_alone == 0) return 0.0;
    return std::min(1.0, double(view->n_rays) / double(view->n_rays_alone));
}

/// Returns true if two boxes overlap by more than kMoverMargin_m along each axis of both
/// boxes (test of separating axes, exact for upright boxes). Boxes of neighbours that
/// only touch do not overlap.
bool overlap_boxes(const Pose& a, const glm::dvec3& size_a_m, const Pose& b, const glm::dvec3& size_b_m) {
    const glm::dmat3 axes_a = glm::mat3_cast(a.rotation), axes_b = glm::mat3_cast(b.rotation);
    // Half the length of a box, projected onto the direction `along`.
    const auto half_extent_m = [](const glm::dmat3& axes, const glm::dvec3& size_m, const glm::dvec3& along) {
        return 0.5 * glm::dot(size_m, glm::abs(along * axes));
    };
    for (const glm::dmat3& axes : {axes_a, axes_b})
        for (int k = 0; k < 3; ++k) {
            const double centre_distance_m = std::abs(glm::dot(a.translation - b.translation, axes[k])),
                         reach_a_m = half_extent_m(axes_a, size_a_m, axes[k]),
                         reach_b_m = half_extent_m(axes_b, size_b_m, axes[k]);
            if (centre_distance_m > reach_a_m + reach_b_m - kMoverMargin_m) return false;
        }
    return true;
}

/// Returns the time at which a box fits its points. If a sweep starts and ends at a box,
/// the box moves between its first and its last returns. It then gets the median time of
/// its returns, to match the larger part.
/// @param faced_s  time at which the sensor points at the centre of the box
/// @param times_s  firing times of the returns on the box, relative to the scan
double choose_box_time(const RenderedScan& scan, double faced_s, std::vector<float> times_s) {
    // A box takes a smaller share of a sweep, unless it is hit at its start and end.
    constexpr double kMostOfSweep = 0.5;
    if (times_s.empty()) return faced_s;
    const auto [first_s, last_s] = std::ranges::minmax(scan.time_offset_s);
    const auto [first_return_s, last_return_s] = std::ranges::minmax(times_s);
    const double box_s = double(last_return_s) - double(first_return_s),
                 sweep_s = double(last_s) - double(first_s);
    if (box_s < kMostOfSweep * sweep_s) return faced_s;
    const auto middle = times_s.begin() + std::ptrdiff_t(times_s.size() / 2);
    std::ranges::nth_element(times_s, middle);  // The mean of two could be between the parts.
    return scan.time_s + double(*middle);
}

}  // namespace

Pose sensor_pose_at(const RenderedScan& scan, double time_s) {
    return scan.track.pose.empty() ? scan.world_from_sensor : scan.track.pose_at(time_s);
}

Velocity object_velocity(const std::function<Pose(double)>& get_world_from_object, double time_s) {
    const Twist twist = compute_twist(get_world_from_object(time_s - kVelocityStep_s),
                                      get_world_from_object(time_s + kVelocityStep_s));
    const glm::dquat object_from_world = glm::conjugate(get_world_from_object(time_s).rotation);
    const double span_s = 2.0 * kVelocityStep_s;
    return {object_from_world * glm::dvec3(twist[0], twist[1], twist[2]) / span_s,
            object_from_world * glm::dvec3(twist[3], twist[4], twist[5]) / span_s};
}

std::vector<ActorInScan> find_actors(const RenderedScan& scan, const ScanOutputOptions& format) {
    const std::vector<SampledRay> rays = sample_rays(scan);
    std::vector<ActorInScan> actors;
    const auto append = [&](const BoxTrack& box, const std::vector<float>& times_s,
                            const ActorVisibility* view) -> ActorInScan& {
        const auto world_from_box = [&box, &format](double t_s) {
            const Pose pose = box.world_from_box.pose_at(t_s);
            return Pose{pose.rotation, pose.translation + format.world_offset_m};
        };
        const double faced_s = time_towards(scan, rays, world_from_box);
        return actors.emplace_back(ActorInScan{&box, world_from_box, choose_box_time(scan, faced_s, times_s),
                                               times_s.size(), visible_share(view)});
    };
    for (const BoxTrack& box : format.actors) {
        const ActorVisibility* view = find_view(scan, box.id);
        if (view || box.is_observed(scan.time_s)) append(box, times_on_actor(scan, format, box.id), view);
    }
    if (format.standing.empty()) return actors;
    const std::size_t n_actors = actors.size();
    const std::vector<BackgroundPoint> points = background_points(scan, format);
    const glm::dvec3 sensor_m = scan.world_from_sensor.translation - format.world_offset_m;
    for (const BoxTrack& box : format.standing) {
        const Pose& world_from_box = box.world_from_box.pose.front();
        const ActorVisibility* view = find_view(scan, box.id);
        // If rays were not counted, lists the objects within the range of the sensor.
        if (!view && (!scan.actor_views.empty() ||
                      glm::distance(world_from_box.translation, sensor_m) > format.limits.max_m))
            continue;
        ActorInScan& object = append(box, times_in_box(points, world_from_box, box.size_m), view);
        object.is_static = true;
        const Pose box_pose = object.world_from_box(object.faced_s);
        const auto covers = [&](const ActorInScan& actor) {
            return overlap_boxes(actor.world_from_box(actor.faced_s), actor.box->size_m, box_pose,
                                 box.size_m);
        };
        const bool is_covered = std::ranges::any_of(std::span(actors).first(n_actors), covers);
        if (is_covered) object.note = LabelNote::covered;
        else if (view && view->n_rays_alone == 0) object.note = LabelNote::not_observed;
    }
    return actors;
}

}  // namespace relidar::scan_files

namespace relidar {

const char* name_of(LabelNote note) {
    constexpr const char* kNames[] = {"", "covered", "not_observed"};
    return kNames[static_cast<int>(note)];
}

std::vector<ActorBox> actor_boxes_of(const RenderedScan& scan, const ScanOutputOptions& format) {
    std::vector<ActorBox> boxes;
    if (scan.actor_views.empty()) return boxes;
    for (const scan_files::ActorInScan& actor : scan_files::find_actors(scan, format)) {
        if (!actor.visible_share) continue;  // No ray would hit the actor.
        // The box fits the points only at the time when the sensor faces the actor.
        const Pose pose = actor.world_from_box(actor.faced_s);
        const glm::dvec3 velocity_mps =
            pose.rotation * scan_files::object_velocity(actor.world_from_box, actor.faced_s).linear_mps;
        const BoxTrack& box = *actor.box;
        boxes.push_back({.track = box.id,
                         .object_class = class_of(box),
                         .label = label_of(box),
                         .is_discovered = is_discovered(box),
                         .is_static = actor.is_static,
                         .note = actor.note,
                         .size_m = box.size_m,
                         .time_s = actor.faced_s,
                         .dataset_from_box = pose,
                         .velocity_mps = velocity_mps,
                         .n_points = actor.n_points,
                         .visible_share = *actor.visible_share});
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
