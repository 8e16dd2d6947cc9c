// SPDX-License-Identifier: Apache-2.0
// Model of the two stacked VLP-32C of Argoverse 2. It has the directions of the lasers
// and determines which laser numbers belong to which LiDAR. It also finds the firing that
// measured each point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar::argoverse2 {

constexpr int kLasers = 32;  ///< lasers per LiDAR

/// A sweep as stored in its file.
struct RawSweep {
    std::vector<glm::dvec3> point_m;  ///< [n] in the vehicle frame at the sweep's time
    std::vector<double> intensity;    ///< [n] intensity of each point, 0..255
    std::vector<std::int64_t> laser;  ///< [n] laser number of each point, 0..63
    /// time of the measurement minus the time of the sweep, in nanoseconds
    std::vector<std::int64_t> offset_ns;
};

/// Returns a VLP-32C with nominal beam angles in its sensor frame. Beams are sorted by
/// elevation, highest first.
/// @param clockwise  true: the head rotates clockwise in the sensor frame, seen from +z
SpinningSensor vlp32c(bool clockwise);

/// Determines which LiDAR has the laser numbers 0 to 31. Returns {0, 1} if the first
/// LiDAR has them, and {1, 0} if it has 32 to 63. Compares the elevations of points with
/// the nominal elevations of the lasers in both cases.
std::array<int, 2> find_halves(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar);

/// The points that one LiDAR measured in a sweep.
struct LidarSweep {
    Points points;  ///< in the LiDAR's frame at the time of each point, with rings, times and firings
    Sweep sweep;
};
/// Returns the points of one of the two LiDARs, selected by its half of the laser
/// numbers. Lasers fire in 16 pairs, so the time and the laser of a point determine its
/// firing. Firings without any point are kept, for example where the vehicle blocks all
/// beams.
/// @param world_from_sensor  poses that the dataset used to move the points to the
/// sweep's time
LidarSweep lidar_sweep(const RawSweep& raw, int half, const Lidar& lidar, const PoseTrack& world_from_sensor,
                       double time_s);

}  // namespace relidar::argoverse2
