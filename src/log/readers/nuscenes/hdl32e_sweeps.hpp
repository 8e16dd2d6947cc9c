// SPDX-License-Identifier: Apache-2.0
// Reader of nuScenes sweeps: the columns of one clockwise revolution of an HDL-32E in
// order of time, motion-compensated to the end of the revolution.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::nuscenes {

/// Returns the LiDAR of nuScenes: an HDL-32E, mounted with a quarter turn to the left.
/// relidar's sensor frame has x forward, nuScenes' frame has x to the right.
/// @param ego_from_lidar  pose in nuScenes' convention
Lidar hdl32e(const Pose& ego_from_lidar);

/// Reads the scans of sequence.frames and completes the sensors.
/// @param files  [frames]
/// @param own  the dataset's poses of the vehicle, to undo its motion compensation
/// @throws DataError with file and point
void read_hdl32e_sweeps(Sequence& sequence, const std::vector<std::filesystem::path>& files,
                        const PoseTrack& own, const DatasetOptions& options);

}  // namespace relidar::nuscenes
