// SPDX-License-Identifier: Apache-2.0
// Model of the two VLP-32C of Argoverse 2: directions of the lasers. Finds the laser
// numbers of each LiDAR, and the firing that measured each point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <relidar/read/clouds.hpp>

namespace relidar::argoverse2 {

constexpr int kLasersPerLidar = 32;  ///< lasers per LiDAR

/// The points of a sweep with the values and units of the file.
struct RawSweep {
    std::vector<glm::dvec3> point_m;  ///< [n] position in the vehicle frame at the time of the sweep
    std::vector<double> intensity;    ///< [n] intensity of each point, 0 to 255
    std::vector<std::int64_t> laser;  ///< [n] laser number of each point, 0 to 63
    std::vector<std::int64_t> offset_ns;
};

/// Returns a VLP-32C with the beam angles of the data sheet, highest beam first.
/// @param clockwise  direction of rotation in the sensor frame, seen from +z
SpinningSensor make_vlp32c(bool clockwise);

/// Finds out which lasers belong to each of the two LiDARs. Returns one value per LiDAR:
/// 0 for the lasers 0 to 31, and 1 for the lasers 32 to 63. Chooses the assignment for
/// which the elevations of points and lasers agree best.
std::array<int, 2> match_laser_groups(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar);

struct SweepPoints {
    /// with rings, times and firings, in the frame of the LiDAR at the time of each point
    LidarPoints points;
    SweepFirings sweep;
};
/// Returns the points of one LiDAR. Time and laser of a point give its firing. Keeps
/// firings without points, for example where the vehicle blocks all beams.
/// @param world_from_sensor  poses with which the dataset moved the points to the time of
/// the sweep
SweepPoints extract_group(const RawSweep& raw_sweep, int laser_group, const Lidar& lidar,
                          const PoseTrack& world_from_sensor, double sweep_time_s);

}  // namespace relidar::argoverse2
