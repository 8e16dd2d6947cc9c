// SPDX-License-Identifier: Apache-2.0
#include "moment_recorder.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/render.hpp>
#include "placed_scan.hpp"

namespace relidar::scan_files {
namespace {

constexpr double kLatest_s = 2147483647.0;  // seconds of a stamp of ROS have 31 bits
constexpr double kPoseStep_s = 0.01;  // between poses readers interpolate: a sensor 2 m from the vehicle's origin is 0.03 mm off at 1 rad/s
constexpr double kVelocityStep_s = 0.005;

/// Where a scan's sensor was at a time of the log.
Pose sensor_pose(const RenderedScan& scan, double time_s) {
    return scan.track.pose.empty() ? scan.world_from_sensor : scan.track.at(time_s);
}

/// @param world_from_thing  by time
template <class PoseAt>
Velocity velocity_of(const PoseAt& world_from_thing, double time_s) {
    const Twist twist = twist_between(world_from_thing(time_s - kVelocityStep_s), world_from_thing(time_s + kVelocityStep_s));
    const glm::dquat to_own = glm::conjugate(world_from_thing(time_s).rotation);
    const double span_s = 2.0 * kVelocityStep_s;
    return {to_own * glm::dvec3(twist[0], twist[1], twist[2]) / span_s, to_own * glm::dvec3(twist[3], twist[4], twist[5]) / span_s};
}

/// Times of a path's own poses between two times, and every kPoseStep_s.
void add_times(std::vector<double>& times_s, const PoseTrack& track, double first_s, double last_s) {
    const int n = std::max(1, static_cast<int>(std::ceil((last_s - first_s) / kPoseStep_s)));
    for (int i = 0; i <= n; ++i) times_s.push_back(i == n ? last_s : first_s + (last_s - first_s) * i / n);
    if (track.time_s.size() < 2) return;
    const auto begin = std::ranges::upper_bound(track.time_s, first_s), end = std::ranges::lower_bound(track.time_s, last_s);
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

std::uint64_t MomentRecorder::stamp(double time_s) const {
    return std::uint64_t(std::llround(1e9 * (time_s + *shift_s_)));
}

void MomentRecorder::check_times(const RenderedScan& scan, const Sweep& all) {
    const bool falls = shift_s_ && scan.time_s < last_scan_s_;
    if (!shift_s_) shift_s_ = all.first_s < 0.0 ? std::ceil(-all.first_s) : 0.0;
    if (falls || !(all.first_s + *shift_s_ >= 0.0 && all.last_s + *shift_s_ < kLatest_s))
        throw DataError(
            fmt::format("writing a recording: found a scan at {} s, expected times that do not fall, and lie before 2038", scan.time_s));
    last_scan_s_ = scan.time_s;
}

RecordedMoment MomentRecorder::take(std::span<const RenderedScan> scans) {
    if (scans.size() != sensors_.size())
        throw UsageError(
            fmt::format("writing a recording: found {} scans, expected {}, one of each sensor", scans.size(), sensors_.size()));
    std::vector<Sweep> sweeps;
    for (std::size_t s = 0; s < scans.size(); ++s) {
        const std::vector<float>& offsets_s = scans[s].time_offset_s;
        const bool rolls = sensors_[s].rolling_shutter && !offsets_s.empty();
        const auto [first, last] = rolls ? std::ranges::minmax(offsets_s) : std::ranges::min_max_result<float>{0.0f, 0.0f};
        sweeps.push_back({scans[s].time_s + double(first), scans[s].time_s + double(last)});
    }
    Sweep all = sweeps.front();
    for (const Sweep& sweep : sweeps) all = {std::min(all.first_s, sweep.first_s), std::max(all.last_s, sweep.last_s)};
    check_times(scans[0], all);
    RecordedMoment moment{stamp(all.first_s), stamp(all.last_s), {}, {}, {}};
    std::vector<double> times_s;
    add_times(times_s, scans[0].track, all.first_s, all.last_s);
    for (std::size_t s = 0; s < scans.size(); ++s) {
        times_s.push_back(sweeps[s].first_s), times_s.push_back(sweeps[s].last_s);
        moment.clouds.push_back(cloud(scans[s], sensors_[s], sweeps[s]));
        moment.actors[moment.clouds.back().stamp_ns] = actors(scans[s].time_s, sweeps[s].first_s);
    }
    moment.poses = poses(scans[0], std::move(times_s));
    return moment;
}

/// @param scan  of the first sensor, whose path is the vehicle's
std::vector<RecordedPose> MomentRecorder::poses(const RenderedScan& scan, std::vector<double> times_s) {
    std::ranges::sort(times_s);
    const Pose sensor_from_vehicle = inverse(rig().sensors.front().vehicle_from_sensor);
    const auto world_from_vehicle = [&](double t_s) { return sensor_pose(scan, t_s) * sensor_from_vehicle; };
    std::vector<RecordedPose> poses;
    for (const double t_s : times_s) {
        const std::uint64_t time_ns = stamp(t_s);
        if (last_pose_ns_ && time_ns <= *last_pose_ns_) continue;  // sweeps may overlap
        poses.push_back({time_ns, world_from_vehicle(t_s), velocity_of(world_from_vehicle, t_s)});
        last_pose_ns_ = time_ns;
    }
    return poses;
}

RecordedCloud MomentRecorder::cloud(const RenderedScan& scan, const ScanFormat& format, const Sweep& sweep) const {
    RecordedCloud result{stamp(sweep.first_s), cloud_of(place(scan, format, sensor_pose(scan, sweep.first_s), 0))};
    for (float& time_s : *result.cloud.time)
        time_s = format.rolling_shutter ? static_cast<float>(double(time_s) - (sweep.first_s - scan.time_s)) : 0.0f;
    return result;
}

/// Those who are there in a scan, in the dataset's world.
/// @param at_s  when they are where they are
std::vector<RecordedActor> MomentRecorder::actors(double scan_s, double at_s) const {
    std::vector<RecordedActor> actors;
    for (const BoxTrack& box : sensors_.front().actors) {
        if (!box.present(scan_s)) continue;
        const auto world_from_box = [&](double t_s) { return box.world_from_box.at(t_s); };
        Pose pose = world_from_box(at_s);
        pose.translation += sensors_.front().world_offset_m;
        actors.push_back({box.id, box.category, pose, box.size_m, velocity_of(world_from_box, at_s), !box.moves()});
    }
    return actors;
}

}  // namespace relidar::scan_files
