// SPDX-License-Identifier: Apache-2.0
#include "log/registration/thin_scans.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_set>

#include "base/cell_key.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

bool is_mover(const RegisterOptions& options, const WorldReturn& world_return) {
    return std::any_of(options.movers.begin(), options.movers.end(), [&](const BoxTrack& box) {
        return box.is_present(world_return.time_s) &&
               box.holds(world_return.point_m, world_return.time_s, options.mover_margin_m);
    });
}

/// Returns the index of the LiDAR with the most returns.
int find_leading_lidar(const Sequence& sequence) {
    std::vector<std::size_t> returns(sequence.lidars.size(), 0);
    if (returns.size() > 1)
        for (const Frame& frame : sequence.frames)
            returns[std::size_t(frame.lidar)] += frame.scan.count_returns();
    return static_cast<int>(std::ranges::max_element(returns) - returns.begin());
}

std::vector<ThinPoint> thin_sweep_points(const Sequence& sequence, const Sweeps& sweeps, std::size_t sweep,
                                         const RegisterOptions& options, double cell_m) {
    std::vector<ThinPoint> points;
    for (const int position : sweeps.frames[sweep])
        for (const std::size_t ray : thin_rays(sequence, position, options, cell_m))
            points.push_back(make_thin_point(sequence, sweeps.track, sweep, position, ray));
    return points;
}

}  // namespace

Sweeps group_frames_by_sweep(const Sequence& sequence) {
    const PoseTrack& given = sequence.world_from_vehicle;
    std::vector<std::vector<int>> frames(given.pose.size());
    std::vector<bool> leads(given.pose.size(), false);
    const int leader = find_leading_lidar(sequence);
    for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
        const std::size_t pose = sequence.get_pose_index(sequence.frames[i]);
        frames[pose].push_back(static_cast<int>(i));
        if (sequence.frames[i].lidar == leader) leads[pose] = true;
    }
    Sweeps sweeps;
    for (std::size_t pose = 0; pose < leads.size(); ++pose) {
        if (!leads[pose]) continue;
        sweeps.track.time_s.push_back(given.time_s[pose]);
        sweeps.track.pose.push_back(given.pose[pose]);
        sweeps.pose.push_back(pose);
        sweeps.frames.push_back(std::move(frames[pose]));
    }
    return sweeps;
}

PoseTrack apply_correction_to_track(const PoseTrack& initial_track, const Sweeps& sweeps,
                                    const PoseTrack& corrected_track) {
    PoseTrack all = initial_track;
    for (std::size_t pose = 0; pose < all.pose.size(); ++pose) {
        const double t_s = all.time_s[pose];
        all.pose[pose] = corrected_track.at(t_s) * (inverse(sweeps.track.at(t_s)) * initial_track.pose[pose]);
        all.pose[pose].rotation = glm::normalize(all.pose[pose].rotation);
    }
    for (std::size_t k = 0; k < sweeps.pose.size(); ++k) all.pose[sweeps.pose[k]] = corrected_track.pose[k];
    return all;
}

std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options,
                                   double cell_m) {
    const Frame& frame = sequence.frames[std::size_t(position)];
    const Scan& scan = frame.scan;
    std::unordered_set<std::uint64_t> taken;
    std::vector<std::size_t> rays;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const std::uint64_t cell = make_cell_key(scan.point(ray), cell_m);
        if (taken.contains(cell) || is_mover(options, compute_world_return(sequence, frame, ray))) continue;
        taken.insert(cell);
        rays.push_back(ray);
    }
    return rays;
}

ThinPoint make_thin_point(const Sequence& sequence, const PoseTrack& track, std::size_t pose, int position,
                          std::size_t ray) {
    const Frame& frame = sequence.frames[std::size_t(position)];
    const RayTable& rays = frame.scan.rays;
    const TrackPosition at = track.place(compute_world_return(sequence, frame, ray).time_s);
    const glm::vec3 in_sensor_m =
        rays.origin[ray] + compute_surface_return(sequence, frame, ray).range_m * rays.direction[ray];
    return {glm::vec3(sequence.get_lidar(frame).vehicle_from_sensor * glm::dvec3(in_sensor_m)),
            static_cast<float>(at.s), static_cast<std::uint32_t>(at.left), static_cast<std::uint32_t>(pose)};
}

PlacedPoint place_point_in_world(const PoseTrack& track, const ThinPoint& point) {
    const Pose pose = track.pose.size() == 1
                          ? track.pose.front()
                          : interpolate(track.pose[point.left], track.pose[point.left + 1], double(point.s));
    return {pose * glm::dvec3(point.point_m), pose.translation};
}

double get_pose_share(const ThinPoint& point, std::size_t pose) {
    return point.left == pose ? 1.0 - double(point.s) : point.left + 1 == pose ? double(point.s) : 0.0;
}

std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const Sweeps& sweeps,
                                               const std::vector<bool>& chosen,
                                               const RegisterOptions& options, double cell_m) {
    std::vector<std::vector<ThinPoint>> scans(chosen.size());
    parallel_for(static_cast<int>(scans.size()), [&](int index) {
        const auto sweep = std::size_t(index);
        if (chosen[sweep]) scans[sweep] = thin_sweep_points(sequence, sweeps, sweep, options, cell_m);
    });
    return scans;
}

}  // namespace relidar
