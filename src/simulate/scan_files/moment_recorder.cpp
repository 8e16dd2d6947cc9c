// SPDX-License-Identifier: Apache-2.0
#include "moment_recorder.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/place_points.hpp>
#include "placed_scan.hpp"
#include "seen_actors.hpp"

namespace relidar::scan_files {
namespace {

// Latest time of a ROS time stamp, whose seconds are a signed 32-bit integer.
constexpr double kLatest_s = 2147483647.0;
// Interval between recorded poses in seconds. Readers interpolate between them. If a
// sensor is 2 m from the vehicle's origin and turns with 1 rad/s, the interpolation error
// is 0.03 mm.
constexpr double kPoseStep_s = 0.01;

/// Adds times from `first_s` to `last_s` at intervals of kPoseStep_s. Between these
/// limits, also adds the times of the track's poses.
void append_pose_sample_times(std::vector<double>& times_s, const PoseTrack& track, double first_s,
                              double last_s) {
    const int n = std::max(1, static_cast<int>(std::ceil((last_s - first_s) / kPoseStep_s)));
    for (int i = 0; i <= n; ++i) times_s.push_back(i == n ? last_s : first_s + (last_s - first_s) * i / n);
    if (track.time_s.size() < 2) return;
    const auto begin = std::ranges::upper_bound(track.time_s, first_s),
               end = std::ranges::lower_bound(track.time_s, last_s);
    if (begin < end) times_s.insert(times_s.end(), begin, end);
}

/// Merges the actors of several scans with the same time stamp. For an actor in several
/// scans, adds up its points, and keeps the largest visible share.
void merge_recorded_actors(std::vector<RecordedActor>& merged_actors, std::vector<RecordedActor> new_actors) {
    for (RecordedActor& actor : new_actors) {
        const auto existing_actor = std::ranges::find(merged_actors, actor.name, &RecordedActor::name);
        if (existing_actor == merged_actors.end()) {
            merged_actors.push_back(std::move(actor));
            continue;
        }
        existing_actor->n_points += actor.n_points;
        existing_actor->visible_share = std::max(existing_actor->visible_share, actor.visible_share);
    }
}

}  // namespace

RecordedRig SweepRecorder::make_recorded_rig() const {
    RecordedRig rig;
    rig.world = sensors_.front().frame == PointCoordinateFrame::world;
    for (const ScanOutputOptions& format : sensors_)
        rig.sensors.push_back({format.topic, format.frame_id, format.vehicle_from_lidar * format.offset});
    return rig;
}

std::uint64_t SweepRecorder::make_time_stamp_ns(double time_s) const {
    return convert_to_nanoseconds(time_s + *shift_s_);
}

void SweepRecorder::require_valid_scan_times_and_set_time_shift(const RenderedScan& scan,
                                                                const SweepInterval& combined_sweep) {
    const bool falls = shift_s_ && scan.time_s < last_scan_s_;
    if (!shift_s_) shift_s_ = combined_sweep.first_s < 0.0 ? std::ceil(-combined_sweep.first_s) : 0.0;
    if (falls ||
        !(combined_sweep.first_s + *shift_s_ >= 0.0 && combined_sweep.last_s + *shift_s_ < kLatest_s))
        throw DataError(fmt::format(
            "cannot write a recording: found a scan at {} s, expected times that do not decrease and "
            "are before the year 2038",
            scan.time_s));
    last_scan_s_ = scan.time_s;
}

RecordedSweep SweepRecorder::convert_scans_to_recorded_sweep(std::span<const RenderedScan> scans) {
    if (scans.size() != sensors_.size())
        throw UsageError(
            fmt::format("cannot write a recording: found {} scans, expected {}, one for each sensor",
                        scans.size(), sensors_.size()));
    std::vector<SweepInterval> sweeps;
    for (std::size_t s = 0; s < scans.size(); ++s) {
        const std::vector<float>& offsets_s = scans[s].time_offset_s;
        const auto [first, last] = offsets_s.empty() ? std::ranges::min_max_result<float>{0.0f, 0.0f}
                                                     : std::ranges::minmax(offsets_s);
        sweeps.push_back({scans[s].time_s + double(first), scans[s].time_s + double(last)});
    }
    SweepInterval all = sweeps.front();
    for (const SweepInterval& sweep : sweeps)
        all = {std::min(all.first_s, sweep.first_s), std::max(all.last_s, sweep.last_s)};
    require_valid_scan_times_and_set_time_shift(scans[0], all);
    RecordedSweep moment{make_time_stamp_ns(all.first_s), make_time_stamp_ns(all.last_s), {}, {}, {}};
    std::vector<double> times_s;
    append_pose_sample_times(times_s, scans[0].track, all.first_s, all.last_s);
    for (std::size_t s = 0; s < scans.size(); ++s) {
        times_s.push_back(sweeps[s].first_s);
        times_s.push_back(sweeps[s].last_s);
        moment.clouds.push_back(make_point_cloud(scans[s], sensors_[s], sweeps[s]));
        merge_recorded_actors(moment.actors[make_time_stamp_ns(sweeps[s].first_s)],
                              list_recorded_actors(scans[s], sweeps[s].first_s));
    }
    moment.poses = compute_vehicle_poses(scans[0], std::move(times_s));
    return moment;
}

/// Returns the poses of the vehicle at the given times.
/// @param scan scan of the first sensor; the path of the vehicle is computed from the
/// path of this sensor
std::vector<RecordedPose> SweepRecorder::compute_vehicle_poses(const RenderedScan& scan,
                                                               std::vector<double> times_s) {
    std::ranges::sort(times_s);
    const Pose sensor_from_vehicle = inverse(make_recorded_rig().sensors.front().vehicle_from_sensor);
    const auto world_from_vehicle = [&](double t_s) {
        return interpolate_sensor_pose_in_scan(scan, t_s) * sensor_from_vehicle;
    };
    std::vector<RecordedPose> poses;
    for (const double t_s : times_s) {
        const std::uint64_t time_ns = make_time_stamp_ns(t_s);
        // Skips times for which a pose was already written, because sweeps can overlap in
        // time.
        if (last_pose_ns_ && time_ns <= *last_pose_ns_) continue;
        poses.push_back({time_ns, world_from_vehicle(t_s), compute_object_velocity(world_from_vehicle, t_s)});
        last_pose_ns_ = time_ns;
    }
    return poses;
}

LidarPoints SweepRecorder::make_point_cloud(const RenderedScan& scan, const ScanOutputOptions& format,
                                            const SweepInterval& sweep) const {
    LidarPoints points = convert_scan_to_points(
        scan, format.config,
        compute_world_from_output_frame(format, interpolate_sensor_pose_in_scan(scan, sweep.first_s)));
    for (float& time_s : points.time_offset_s)
        time_s = static_cast<float>(double(time_s) - (sweep.first_s - scan.time_s));
    points.time_s = sweep.first_s + *shift_s_;
    return points;
}

/// Returns the boxes of the actors that are present during a scan, in the world frame of
/// the dataset.
std::vector<RecordedActor> SweepRecorder::list_recorded_actors(const RenderedScan& scan,
                                                               double cloud_time_s) const {
    std::vector<RecordedActor> actors;
    for (const ActorInScan& actor : find_actors_present_in_scan(scan, sensors_.front())) {
        const auto state = [&](double t_s) {
            return BoxState{make_time_stamp_ns(t_s), actor.world_from_box(t_s),
                            compute_object_velocity(actor.world_from_box, t_s)};
        };
        const BoxTrack& box = *actor.box;
        actors.push_back({box.id, box.category, box.size_m, !box.is_moving(), state(actor.faced_s),
                          state(cloud_time_s), actor.n_points, actor.visible_share});
    }
    return actors;
}

}  // namespace relidar::scan_files
