// SPDX-License-Identifier: Apache-2.0
// The two stacked VLP-32C of Argoverse 2: directions of the lasers, the half of the laser
// numbers that belongs to each LiDAR, and the firing of each point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::argoverse2 {

constexpr int kLasers = 32;  ///< lasers per LiDAR

/// A sweep as stored in its file.
struct RawSweep {
    std::vector<glm::dvec3> point_m;      ///< [n] in the vehicle frame at the sweep's time
    std::vector<double> intensity;        ///< [n] intensity of each point, 0..255
    std::vector<std::int64_t> laser;      ///< [n] laser number of each point, 0..63
    std::vector<std::int64_t> offset_ns;  ///< [n] time of measurement, relative to the sweep's time
};

/// Returns a nominal VLP-32C in its sensor frame, beams highest first.
/// @param clockwise  direction of rotation in the sensor frame, z up
SpinningSensor vlp32c(bool clockwise);

/// Determines which half of the laser numbers belongs to which LiDAR: {0, 1} if the first
/// LiDAR has 0..31, {1, 0} if it has 32..63. Only for the right LiDAR do the points of
/// each laser have the elevation of its beam.
std::array<int, 2> find_halves(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar);

/// Measurements of one LiDAR in a sweep.
struct LidarSweep {
    Points points;  ///< in the LiDAR's frame at the time of each point, with rings, times and firings
    Sweep sweep;
};
/// Returns the points of one half of the laser numbers. Lasers fire in 16 pairs, so time
/// and laser determine the firing. A firing without any point counts too, for example
/// where the vehicle blocks all beams.
/// @param world_from_sensor  poses with which the dataset moved the points to the sweep's
/// time
LidarSweep lidar_sweep(const RawSweep& raw, int half, const Lidar& lidar, const PoseTrack& world_from_sensor,
                       double time_s);

}  // namespace relidar::argoverse2
