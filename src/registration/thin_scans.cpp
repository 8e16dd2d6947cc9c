// SPDX-License-Identifier: Apache-2.0
#include "registration/thin_scans.hpp"

#include <algorithm>
#include <unordered_set>

#include "base/geometry/cell_key.hpp"
#include "base/parallel.hpp"

namespace relidar {

namespace {

/// Returns the index of the LiDAR with the most returns in the log.
int find_main_lidar(const Log& log) {
    if (log.lidars.size() < 2) return 0;
    std::vector<std::size_t> n_returns(log.lidars.size(), 0);
    for (const Frame& frame : log.frames) n_returns[std::size_t(frame.lidar)] += frame.scan.count_returns();
    return static_cast<int>(std::ranges::max_element(n_returns) - n_returns.begin());
}

}  // namespace

SweepSet group_sweeps(const Log& log) {
    const int main_lidar = find_main_lidar(log);
    const PoseTrack& vehicle_track = log.world_from_vehicle;
    std::vector<std::vector<int>> frames_at_pose(vehicle_track.pose.size());
    std::vector<bool> has_main_frame(vehicle_track.pose.size(), false);
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const std::size_t pose = log.find_pose_index(log.frames[i]);
        frames_at_pose[pose].push_back(static_cast<int>(i));
        if (log.frames[i].lidar == main_lidar) has_main_frame[pose] = true;
    }
    SweepSet sweeps;
    for (std::size_t pose = 0; pose < has_main_frame.size(); ++pose) {
        if (!has_main_frame[pose]) continue;  // spread_corrections() interpolates its correction
        sweeps.track.append(vehicle_track.time_s[pose], vehicle_track.pose[pose]);
        sweeps.pose.push_back(pose);
        sweeps.frames.push_back(std::move(frames_at_pose[pose]));
    }
    return sweeps;
}

PoseTrack spread_corrections(const PoseTrack& initial, const SweepSet& sweeps, const PoseTrack& corrected) {
    PoseTrack all = initial;
    for (std::size_t pose = 0; pose < all.pose.size(); ++pose) {
        const double t_s = all.time_s[pose];
        // Keeps the motion of this pose relative to the interpolated track of the sweeps.
        const Pose relative_pose = inverse(sweeps.track.pose_at(t_s)) * initial.pose[pose];
        all.pose[pose] = corrected.pose_at(t_s) * relative_pose;
        all.pose[pose].rotation = glm::normalize(all.pose[pose].rotation);
    }
    // Sweeps have exactly the registered poses, without rounding.
    for (std::size_t k = 0; k < sweeps.pose.size(); ++k) all.pose[sweeps.pose[k]] = corrected.pose[k];
    return all;
}

std::vector<std::size_t> select_returns(const Log& log, int frame_index, const RegistrationOptions& options,
                                        double cell_size_m) {
    const Frame& frame = log.frames[std::size_t(frame_index)];
    const Scan& scan = frame.scan;
    std::unordered_set<std::uint64_t> occupied_cells;
    std::vector<std::size_t> rays;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const std::uint64_t cell = grid_key(scan.return_point(ray), cell_size_m);
        if (occupied_cells.contains(cell)) continue;
        // The test of the boxes is slow, so it follows the test of the cell.
        const WorldReturn world_return = locate_return(log, frame, ray);
        const auto contains_return = [&](const BoxTrack& box) {
            return box.is_observed(world_return.time_s) &&
                   box.contains_point(world_return.point_m, world_return.time_s, options.mover_margin_m);
        };
        if (std::any_of(options.movers.begin(), options.movers.end(), contains_return)) continue;
        occupied_cells.insert(cell);
        rays.push_back(ray);
    }
    return rays;
}

SubsampledPoint make_point(const Log& log, const PoseTrack& track, std::size_t pose_index, int frame_index,
                           std::size_t ray_index) {
    const Frame& frame = log.frames[std::size_t(frame_index)];
    const RayTable& rays = frame.scan.rays;
    // The firing time is between the poses `left` and `left + 1`. `s` weights the second.
    const TrackInterpolation firing = track.find_segment(locate_return(log, frame, ray_index).time_s);
    // surface_return() corrects the range for the beam.
    const float range_m = surface_return(log, frame, ray_index).range_m;
    const glm::vec3 in_sensor_m = rays.origin[ray_index] + range_m * rays.direction[ray_index];
    const Pose& vehicle_from_sensor = log.lidar_of(frame).vehicle_from_sensor;
    return {.point_m = glm::vec3(vehicle_from_sensor * glm::dvec3(in_sensor_m)),
            .s = static_cast<float>(firing.s),
            .left = static_cast<std::uint32_t>(firing.left),
            .pose = static_cast<std::uint32_t>(pose_index)};
}

WorldPointWithOrigin point_to_world(const PoseTrack& track, const SubsampledPoint& point) {
    const Pose pose = track.pose.size() == 1
                          ? track.pose.front()
                          : interpolate(track.pose[point.left], track.pose[point.left + 1], double(point.s));
    return {pose * glm::dvec3(point.point_m), pose.translation};
}

double weight_of_pose(const SubsampledPoint& point, std::size_t pose_index) {
    if (point.left == pose_index) return 1.0 - double(point.s);
    return point.left + 1 == pose_index ? double(point.s) : 0.0;
}

SubsampledScans thin_sweeps(const Log& log, const SweepSet& sweeps,
                            const std::vector<bool>& is_sweep_selected, const RegistrationOptions& options,
                            double cell_size_m) {
    SubsampledScans scans(is_sweep_selected.size());
    parallel_for(static_cast<int>(scans.size()), [&](int index) {
        const auto sweep = std::size_t(index);
        if (!is_sweep_selected[sweep]) return;
        for (const int position : sweeps.frames[sweep])
            for (const std::size_t ray : select_returns(log, position, options, cell_size_m))
                scans[sweep].push_back(make_point(log, sweeps.track, sweep, position, ray));
    });
    return scans;
}

}  // namespace relidar
