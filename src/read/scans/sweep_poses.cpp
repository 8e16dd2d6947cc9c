// SPDX-License-Identifier: Apache-2.0
#include "read/scans/sweep_poses.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

#include "base/parallel.hpp"

namespace relidar::read {
namespace {

// Pose corrections are computed at this interval and interpolated in between.
constexpr double kCorrectionStep_s = 1e-3;
// Smaller corrections are skipped. The range errors of sensors are ten times larger.
constexpr double kMinCorrection_m = 1e-3;
// A rotation is measured in metres: how far it moves a point at this distance.
constexpr double kLeverArm_m = 50.0;

/// Returns the errors of the sensor poses in a sweep, which the log interpolates between
/// the poses of its frames: transforms from the true to the interpolated sensor frame.
/// Times are relative to the frame.
/// @param find_vehicle_pose  true poses, also between frames
PoseTrack pose_corrections_of(const Log& log, const Frame& frame, const PoseLookup& find_vehicle_pose) {
    const Pose& mounted = log.lidar_of(frame).vehicle_from_sensor;
    const auto [first, last] = std::ranges::minmax(frame.scan.rays.time_offset_s);
    const int n = 1 + int(std::ceil(double(last - first) / kCorrectionStep_s));
    PoseTrack track;
    for (int k = 0; k <= n; ++k) {
        const double offset_s = double(first) + double(last - first) * k / n;
        const double time_s = frame.time_s + offset_s;
        const std::optional<Pose> true_pose = find_vehicle_pose(time_s);
        // If all rays have the same time, all steps have it, too.
        const bool is_same_time = !track.time_s.empty() && offset_s <= track.time_s.back();
        if (!true_pose || is_same_time) continue;
        const Pose interpolated_pose = log.world_from_vehicle.mounted_pose_at(time_s, mounted);
        track.append(offset_s, inverse(interpolated_pose) * (*true_pose * mounted));
    }
    return track;
}

/// Applies pose corrections to the origins and directions of all rays of a frame.
/// @return maximum movement of a point at kLeverArm_m in metres; 0: nothing was changed
double move_rays(Frame& frame, const PoseTrack& pose_corrections) {
    double farthest_m = 0.0;
    for (const Pose& pose : pose_corrections.pose) {
        // The vector part of a quaternion has the length sin(angle / 2).
        const double sine = glm::length(glm::dvec3(pose.rotation.x, pose.rotation.y, pose.rotation.z));
        const double angle_rad = 2.0 * std::asin(std::min(sine, 1.0));
        farthest_m = std::max(farthest_m, glm::length(pose.translation) + kLeverArm_m * angle_rad);
    }
    if (farthest_m < kMinCorrection_m) return 0.0;
    RayTable& rays = frame.scan.rays;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const double t_s = std::clamp(double(rays.time_offset_s[i]), pose_corrections.time_s.front(),
                                      pose_corrections.time_s.back());
        const Pose pose = pose_corrections.pose_at(t_s);
        rays.origin[i] = glm::vec3(pose * glm::dvec3(rays.origin[i]));
        rays.direction[i] = glm::vec3(glm::normalize(pose.rotation * glm::dvec3(rays.direction[i])));
    }
    return farthest_m;
}

}  // namespace

std::string correct_rays(Log& log, const PoseLookup& find_vehicle_pose) {
    if (!log.rolling_shutter) return "";
    // [frames] how far a point at kLeverArm_m moves; 0 if the frame is not changed
    std::vector<double> moved_m(log.frames.size(), 0.0);
    parallel_for(int(log.frames.size()), [&](int index) {
        Frame& frame = log.frames[std::size_t(index)];
        if (frame.scan.rays.size() == 0) return;
        const PoseTrack track = pose_corrections_of(log, frame, find_vehicle_pose);
        if (!track.pose.empty()) moved_m[std::size_t(index)] = move_rays(frame, track);
    });
    const auto n_moved = std::ranges::count_if(moved_m, [](double m) { return m > 0.0; });
    if (n_moved == 0) return "";
    return fmt::format(
        "the ray origins of {} sweeps are computed from poses between the frames, which moves points at "
        "{:.0f} m by up to {:.3f} m",
        n_moved, kLeverArm_m, std::ranges::max(moved_m));
}

}  // namespace relidar::read
