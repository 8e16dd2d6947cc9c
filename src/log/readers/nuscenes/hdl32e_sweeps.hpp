// SPDX-License-Identifier: Apache-2.0
// Sweeps of nuScenes itself: the columns of one clockwise turn of an HDL-32E in order of
// time, brought to the end of the turn.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::nuscenes {

/// LiDAR of nuScenes: HDL-32E, mounted a quarter to the left, since relidar's frame has x
/// forward where nuScenes' has it to the right.
/// @param ego_from_lidar  as nuScenes has it
Lidar hdl32e(const Pose& ego_from_lidar);

/// Reads the scans of sequence.frames and completes the sensors. @param files  [frames]
/// @param own  the dataset's poses of the vehicle, to undo its motion compensation
/// @throws DataError naming file and point
void read_hdl32e_sweeps(Sequence& sequence, const std::vector<std::filesystem::path>& files,
                        const PoseTrack& own, const DatasetOptions& options);

}  // namespace relidar::nuscenes
