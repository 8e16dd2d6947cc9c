// SPDX-License-Identifier: Apache-2.0
#include "moment_recorder.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/place_points.hpp>
#include "placed_scan.hpp"

namespace relidar::scan_files {
namespace {

// Latest time of a ROS time stamp, whose seconds have 31 bits.
constexpr double kLatest_s = 2147483647.0;
// Interval between recorded poses in seconds. Readers interpolate between two recorded
// poses. For a sensor that is 2 m from the vehicle's origin and turns with 1 rad/s, the
// interpolation error is 0.03 mm.
constexpr double kPoseStep_s = 0.01;
constexpr double kVelocityStep_s = 0.005;

/// Returns the pose of the sensor at time `time_s` of the log, in the world frame of the
/// dataset.
Pose sensor_pose(const RenderedScan& scan, double time_s) {
    return scan.track.pose.empty() ? scan.world_from_sensor : scan.track.at(time_s);
}

/// Returns the velocity of an object, computed by central differences of its poses.
/// @param world_from_thing returns the pose of the object at a given time
template <class PoseAt>
Velocity velocity_of(const PoseAt& world_from_thing, double time_s) {
    const Twist twist =
        twist_between(world_from_thing(time_s - kVelocityStep_s), world_from_thing(time_s + kVelocityStep_s));
    const glm::dquat thing_from_world = glm::conjugate(world_from_thing(time_s).rotation);
    const double span_s = 2.0 * kVelocityStep_s;
    return {thing_from_world * glm::dvec3(twist[0], twist[1], twist[2]) / span_s,
            thing_from_world * glm::dvec3(twist[3], twist[4], twist[5]) / span_s};
}

/// A subset of the rays of a scan. The rays are spread evenly over the scan.
class SampledRays {
public:
    explicit SampledRays(const RenderedScan& scan) : scan_(scan) {
        constexpr std::size_t kMost = 4096;
        // The step is odd, so that the selected columns differ between the rows.
        const std::size_t n = scan.image.direction.size(), step = (n / kMost) | 1;
        for (std::size_t i = 0; i < n; i += step)
            rays_.push_back({scan.image.direction[i], scan.time_offset_s[i]});
    }
    /// Returns the firing time of the ray that passes closest to a moving point.
    /// @param place_m returns the position of the point at a given time, in the world
    /// frame of the dataset
    template <class PlaceAt>
    double faced_at(const PlaceAt& place_m) const {
        // Number of iterations. Each new firing time changes the positions of the point
        // and the sensor, so the search is repeated.
        constexpr int kRounds = 3;
        double time_s = scan_.time_s;
        for (int round = 0; round < kRounds && !rays_.empty(); ++round) {
            const glm::vec3 towards(glm::normalize(inverse(sensor_pose(scan_, time_s)) * place_m(time_s)));
            const auto cosine = [&](const Ray& ray) { return glm::dot(ray.direction, towards); };
            time_s = scan_.time_s + double(std::ranges::max_element(rays_, {}, cosine)->time_offset_s);
        }
        return time_s;
    }

private:
    struct Ray {
        glm::vec3 direction;
        float time_offset_s;
    };
    const RenderedScan& scan_;
    std::vector<Ray> rays_;
};

/// Adds times from `first_s` to `last_s` at intervals of kPoseStep_s. Also adds the times
/// of all poses of a track between these limits.
void add_times(std::vector<double>& times_s, const PoseTrack& track, double first_s, double last_s) {
    const int n = std::max(1, static_cast<int>(std::ceil((last_s - first_s) / kPoseStep_s)));
    for (int i = 0; i <= n; ++i) times_s.push_back(i == n ? last_s : first_s + (last_s - first_s) * i / n);
    if (track.time_s.size() < 2) return;
    const auto begin = std::ranges::upper_bound(track.time_s, first_s),
               end = std::ranges::lower_bound(track.time_s, last_s);
    if (begin < end) times_s.insert(times_s.end(), begin, end);
}

}  // namespace

RecordedRig MomentRecorder::rig() const {
    RecordedRig rig;
    rig.world = sensors_.front().frame == PointFrame::world;
    for (const ScanFormat& format : sensors_)
        rig.sensors.push_back({format.topic, format.frame_id, format.vehicle_from_lidar * format.offset});
    return rig;
}

std::uint64_t MomentRecorder::stamp(double time_s) const { return stamp_of(time_s + *shift_s_); }

void MomentRecorder::check_times(const RenderedScan& scan, const Sweep& all) {
    const bool falls = shift_s_ && scan.time_s < last_scan_s_;
    if (!shift_s_) shift_s_ = all.first_s < 0.0 ? std::ceil(-all.first_s) : 0.0;
    if (falls || !(all.first_s + *shift_s_ >= 0.0 && all.last_s + *shift_s_ < kLatest_s))
        throw DataError(fmt::format(
            "cannot write a recording: found a scan at {} s, expected times that do not decrease and "
            "are before the year 2038",
            scan.time_s));
    last_scan_s_ = scan.time_s;
}

RecordedMoment MomentRecorder::take(std::span<const RenderedScan> scans) {
    if (scans.size() != sensors_.size())
        throw UsageError(
            fmt::format("cannot write a recording: found {} scans, expected {}, one for each sensor",
                        scans.size(), sensors_.size()));
    std::vector<Sweep> sweeps;
    for (std::size_t s = 0; s < scans.size(); ++s) {
        const std::vector<float>& offsets_s = scans[s].time_offset_s;
        const auto [first, last] = offsets_s.empty() ? std::ranges::min_max_result<float>{0.0f, 0.0f}
                                                     : std::ranges::minmax(offsets_s);
        sweeps.push_back({scans[s].time_s + double(first), scans[s].time_s + double(last)});
    }
    Sweep all = sweeps.front();
    for (const Sweep& sweep : sweeps)
        all = {std::min(all.first_s, sweep.first_s), std::max(all.last_s, sweep.last_s)};
    check_times(scans[0], all);
    RecordedMoment moment{stamp(all.first_s), stamp(all.last_s), {}, {}, {}};
    std::vector<double> times_s;
    add_times(times_s, scans[0].track, all.first_s, all.last_s);
    for (std::size_t s = 0; s < scans.size(); ++s) {
        times_s.push_back(sweeps[s].first_s), times_s.push_back(sweeps[s].last_s);
        moment.clouds.push_back(cloud(scans[s], sensors_[s], sweeps[s]));
        moment.actors[stamp(sweeps[s].first_s)] = actors(scans[s], sweeps[s].first_s);
    }
    moment.poses = poses(scans[0], std::move(times_s));
    return moment;
}

/// Returns the poses of the vehicle at the given times.
/// @param scan scan of the first sensor; the path of the vehicle is computed from this
/// sensor's path
std::vector<RecordedPose> MomentRecorder::poses(const RenderedScan& scan, std::vector<double> times_s) {
    std::ranges::sort(times_s);
    const Pose sensor_from_vehicle = inverse(rig().sensors.front().vehicle_from_sensor);
    const auto world_from_vehicle = [&](double t_s) { return sensor_pose(scan, t_s) * sensor_from_vehicle; };
    std::vector<RecordedPose> poses;
    for (const double t_s : times_s) {
        const std::uint64_t time_ns = stamp(t_s);
        // Skips a time for which a pose is already written, because sweeps can overlap.
        if (last_pose_ns_ && time_ns <= *last_pose_ns_) continue;
        poses.push_back({time_ns, world_from_vehicle(t_s), velocity_of(world_from_vehicle, t_s)});
        last_pose_ns_ = time_ns;
    }
    return poses;
}

Points MomentRecorder::cloud(const RenderedScan& scan, const ScanFormat& format, const Sweep& sweep) const {
    Points points =
        place_points(scan, format.config, frame_of_points(format, sensor_pose(scan, sweep.first_s)));
    for (float& time_s : points.time_offset_s)
        time_s = static_cast<float>(double(time_s) - (sweep.first_s - scan.time_s));
    points.time_s = sweep.first_s + *shift_s_;
    return points;
}

/// Returns the boxes of the actors that are present during a scan, in the world frame of
/// the dataset.
std::vector<RecordedActor> MomentRecorder::actors(const RenderedScan& scan, double stamp_s) const {
    const SampledRays rays(scan);
    std::vector<RecordedActor> actors;
    for (const BoxTrack& box : sensors_.front().actors) {
        if (!box.present(scan.time_s)) continue;
        const auto world_from_box = [&](double t_s) {
            const Pose pose = box.world_from_box.at(t_s);
            return Pose{pose.rotation, pose.translation + sensors_.front().world_offset_m};
        };
        const auto state = [&](double t_s) {
            return BoxState{stamp(t_s), world_from_box(t_s), velocity_of(world_from_box, t_s)};
        };
        const double faced_s = rays.faced_at([&](double t_s) { return world_from_box(t_s).translation; });
        actors.push_back({box.id, box.category, box.size_m, !box.moves(), state(faced_s), state(stamp_s)});
    }
    return actors;
}

}  // namespace relidar::scan_files
