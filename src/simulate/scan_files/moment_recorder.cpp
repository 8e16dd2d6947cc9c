// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <iterator>

#include "base/fail.hpp"
#include "simulate/scan_files/recorded_moment.hpp"

#include <relidar/simulate/place_points.hpp>
#include "simulate/scan_files/placed_scan.hpp"

namespace relidar::scan_files {
namespace {

// ROS stores seconds as a signed 32-bit integer.
constexpr std::int64_t kMaxStamp_ns = 2'147'483'647'000'000'000;
// The interval of a sweep ends this much later than its last ray. Readers can then find
// the transform at the time of each point, although these times are rounded to floats.
constexpr double kStampRounding_s = 2e-8;
// Readers interpolate between poses. If a sensor is 2 m from the vehicle's origin and
// turns with 1 rad/s, the error is 0.03 mm.
constexpr double kPoseStep_s = 0.01;

/// Adds times from `first_s` to `last_s` at intervals of at most kPoseStep_s, and the
/// times of the track's poses between these limits.
void add_pose_times(std::vector<double>& times_s, const PoseTrack& track, double first_s, double last_s) {
    const int n = std::max(1, static_cast<int>(std::ceil((last_s - first_s) / kPoseStep_s)));
    for (int i = 0; i <= n; ++i) times_s.push_back(i == n ? last_s : first_s + (last_s - first_s) * i / n);
    if (track.time_s.size() < 2) return;
    const auto begin = std::ranges::upper_bound(track.time_s, first_s),
               end = std::ranges::lower_bound(track.time_s, last_s);
    if (begin < end) times_s.insert(times_s.end(), begin, end);
}

/// Merges the actors in the scans of several sensors. Adds up the points of an actor, and
/// keeps its largest visible share and its box in the scan with most points.
std::vector<RecordedActor> merge_actors(std::vector<RecordedActor> actors_of_scans) {
    std::vector<RecordedActor> merged;
    std::vector<std::size_t> n_points;  // in all scans, of each merged actor
    for (RecordedActor& actor : actors_of_scans) {
        const auto known = std::ranges::find_if(
            merged, [&](const RecordedActor& other) { return other.box->id == actor.box->id; });
        if (known == merged.end()) {
            n_points.push_back(actor.n_points);
            merged.push_back(std::move(actor));
            continue;
        }
        n_points[std::size_t(known - merged.begin())] += actor.n_points;
        const std::optional<double> share = std::max(known->visible_share, actor.visible_share);
        if (known->n_points < actor.n_points) *known = std::move(actor);
        known->visible_share = share;
    }
    for (std::size_t i = 0; i < merged.size(); ++i) merged[i].n_points = n_points[i];
    return merged;
}

/// Rounds a time to 10 ns, because floats have errors of some nanoseconds. The stamp of a
/// ray at -0.05 s would otherwise be 1 ns too small.
double round_to_10ns(float time_s) { return 1e-8 * std::round(1e8 * double(time_s)); }

}  // namespace

SweepInterval sweep_interval(std::span<const RenderedScan> scans) {
    SweepInterval all{INFINITY, -INFINITY};
    for (const RenderedScan& scan : scans) {
        // Times of the first and the last ray, relative to the scan.
        std::ranges::minmax_result<float> offsets_s{0.0f, 0.0f};
        if (!scan.time_offset_s.empty()) offsets_s = std::ranges::minmax(scan.time_offset_s);
        all.first_s = std::min(all.first_s, scan.time_s + round_to_10ns(offsets_s.min));
        // Later than the last ray, so that rounded times are inside the interval.
        all.last_s = std::max(all.last_s, scan.time_s + round_to_10ns(offsets_s.max) + kStampRounding_s);
    }
    return all;
}

SweepInterval check_times(std::span<const RenderedScan> scans, std::int64_t time_shift_ns) {
    const SweepInterval all = sweep_interval(scans);
    if (std::abs(scans[0].time_s) < 4e9 && to_stamp_ns(all.first_s, time_shift_ns) >= 0 &&
        to_stamp_ns(all.last_s, time_shift_ns) < kMaxStamp_ns)
        return all;
    fail("cannot record a scan at {} s: found stamps from {:.3f} to {:.3f} s, expected 1970 to 2037",
         scans[0].time_s, all.first_s + 1e-9 * double(time_shift_ns),
         all.last_s + 1e-9 * double(time_shift_ns));
}

std::string RecordedRig::cloud_frame(std::size_t sensor) const {
    if (has_map_frame()) return kMapFrame;
    return world ? kWorldFrame : sensors[sensor].frame_id;
}

std::vector<StaticTransform> RecordedRig::static_transforms() const {
    std::vector<StaticTransform> transforms;
    for (const RecordedSensor& sensor : sensors)
        transforms.push_back({kVehicleFrame, sensor.frame_id, sensor.vehicle_from_sensor});
    if (has_map_frame()) transforms.push_back({kWorldFrame, kMapFrame, {{1, 0, 0, 0}, points_origin_m}});
    return transforms;
}

RecordedRig SweepRecorder::recorded_rig() const {
    RecordedRig rig;
    rig.world = sensors_.front().frame == PointCoordinateFrame::world;
    rig.points_origin_m = points_origin_m(sensors_.front());
    if (sensors_.front().georeference && has_proj()) rig.earth.emplace(*sensors_.front().georeference);
    for (const ScanOutputOptions& format : sensors_)
        rig.sensors.push_back({format.topic, format.frame_id, format.vehicle_from_lidar * format.offset});
    return rig;
}

std::uint64_t SweepRecorder::to_stamp_ns(double time_s) const {
    return std::uint64_t(scan_files::to_stamp_ns(time_s, sensors_.front().time_shift_ns));
}

RecordedSweep SweepRecorder::record(std::span<const RenderedScan> scans) {
    if (scans.size() != sensors_.size())
        fail<UsageError>("cannot write a recording: found {} scans, expected {}, one for each sensor",
                         scans.size(), sensors_.size());
    const SweepInterval all = check_times(scans, sensors_.front().time_shift_ns);
    if (last_scan_s_ && scans[0].time_s < *last_scan_s_)
        fail("cannot write a recording: found a scan at {} s, expected times that do not decrease",
             scans[0].time_s);
    last_scan_s_ = scans[0].time_s;
    RecordedSweep sweep{.first_ns = to_stamp_ns(all.first_s), .last_ns = to_stamp_ns(all.last_s)};
    // Times of the vehicle's poses, including the stamps of all clouds.
    std::vector<double> pose_times_s;
    add_pose_times(pose_times_s, scans[0].track, all.first_s, all.last_s);
    std::vector<RecordedActor> actors_of_scans;
    for (std::size_t s = 0; s < scans.size(); ++s) {
        const SweepInterval of_sensor = sweep_interval(scans.subspan(s, 1));
        pose_times_s.push_back(of_sensor.first_s);
        pose_times_s.push_back(of_sensor.last_s);
        sweep.clouds.push_back(make_cloud(scans[s], sensors_[s], of_sensor.first_s));
        std::ranges::move(recorded_actors(scans[s], all.first_s), std::back_inserter(actors_of_scans));
    }
    sweep.actors = merge_actors(std::move(actors_of_scans));
    sweep.poses = vehicle_poses(scans[0], std::move(pose_times_s));
    if (earth_ && !sweep.poses.empty()) {
        const ObjectState& first = sweep.poses.front();
        sweep.fixes.push_back({first.time_ns, earth_->to_geodetic(first.world_from_object.translation)});
    }
    return sweep;
}

ObjectState SweepRecorder::state_at(const std::function<Pose(double)>& world_from_object,
                                    double time_s) const {
    return {to_stamp_ns(time_s), world_from_object(time_s), object_velocity(world_from_object, time_s)};
}

/// Returns the poses of the vehicle at the given times, except times that are not later
/// than the last pose of an earlier call: sweeps can overlap in time.
/// @param scan scan of the first sensor
std::vector<ObjectState> SweepRecorder::vehicle_poses(const RenderedScan& scan, std::vector<double> at_s) {
    std::ranges::sort(at_s);
    const Pose sensor_from_vehicle = inverse(sensors_.front().vehicle_from_lidar * sensors_.front().offset);
    const auto world_from_vehicle = [&](double t_s) {
        return sensor_pose_at(scan, t_s) * sensor_from_vehicle;
    };
    std::vector<ObjectState> poses;
    for (const double t_s : at_s) {
        const std::uint64_t time_ns = to_stamp_ns(t_s);
        if (last_pose_ns_ && time_ns <= *last_pose_ns_) continue;
        poses.push_back(state_at(world_from_vehicle, t_s));
        last_pose_ns_ = time_ns;
    }
    return poses;
}

/// Returns the points of a scan, which are stamped with the time of the first ray.
/// @param first_s time of the first ray
RecordedCloud SweepRecorder::make_cloud(const RenderedScan& scan, const ScanOutputOptions& format,
                                        double first_s) const {
    RecordedCloud cloud{
        to_stamp_ns(first_s),
        place_points(scan, format.config, world_from_output(format, sensor_pose_at(scan, first_s)))};
    // Makes the times, which are relative to the scan, relative to the stamp. The first
    // would be some nanoseconds below 0, because the stamp is rounded.
    for (float& time_s : cloud.points.time_offset_s)
        time_s = static_cast<float>(std::max(0.0, double(time_s) - (first_s - scan.time_s)));
    return cloud;
}

/// Returns the actors in a scan.
/// @param stamp_s  time of the stamp of the sweep
std::vector<RecordedActor> SweepRecorder::recorded_actors(const RenderedScan& scan, double stamp_s) const {
    std::vector<RecordedActor> actors;
    // All sensors have the same list of actors, so the options of the first are enough.
    for (const ActorInScan& actor : find_actors(scan, sensors_.front()))
        actors.push_back(
            {actor, state_at(actor.world_from_box, actor.faced_s), state_at(actor.world_from_box, stamp_s)});
    return actors;
}

}  // namespace relidar::scan_files
