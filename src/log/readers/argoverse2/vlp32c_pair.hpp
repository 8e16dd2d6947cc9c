// SPDX-License-Identifier: Apache-2.0
// The two stacked VLP-32C of Argoverse 2: which laser points where, which half of the
// laser numbers belongs to which LiDAR, and the firing that took each point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::argoverse2 {

constexpr int kLasers = 32;  ///< of one LiDAR

/// A sweep as the file has it.
struct RawSweep {
    std::vector<glm::dvec3> point_m;      ///< [n] vehicle frame at the sweep's time
    std::vector<double> intensity;        ///< [n] 0..255
    std::vector<std::int64_t> laser;      ///< [n] 0..63
    std::vector<std::int64_t> offset_ns;  ///< [n] when it was measured, after the sweep's time
};

/// Nominal VLP-32C in its own frame, beams highest first. @param clockwise  as it turns
/// in its own frame, z up
SpinningSensor vlp32c(bool clockwise);

/// The half of the laser numbers that belongs to each LiDAR: {0, 1} where the first LiDAR
/// has 0..31, {1, 0} where it has 32..63. The points tell it: only the right LiDAR sees
/// each laser's at the elevation of its beam.
std::array<int, 2> find_halves(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar);

/// What one LiDAR measured.
struct LidarSweep {
    Points points;  ///< in the LiDAR's frame at the moment of each, with rings, times and firings
    Sweep sweep;
};
/// Points of a half of the laser numbers. Lasers fire in 16 pairs, so that time and laser
/// tell the firing; one without any point, as where the vehicle hides the world from all
/// beams, is a firing too.
/// @param world_from_sensor  poses by which the points were brought to the sweep's time
LidarSweep lidar_sweep(const RawSweep& raw, int half, const Lidar& lidar, const PoseTrack& world_from_sensor,
                       double time_s);

}  // namespace relidar::argoverse2
