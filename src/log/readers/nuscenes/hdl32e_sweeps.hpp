// SPDX-License-Identifier: Apache-2.0
// Reads the sweeps of nuScenes. A file has one revolution of an HDL-32E, which rotates
// clockwise, column by column in order of time. The dataset has moved all points to the
// end of the revolution (motion compensation).
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::nuscenes {

/// Returns the LiDAR of nuScenes, an HDL-32E. In relidar's sensor frame x points forward,
/// but in nuScenes' frame x points to the right. So the pose is rotated by 90 degrees.
/// @param ego_from_lidar  pose of the LiDAR in nuScenes' convention
Lidar hdl32e(const Pose& ego_from_lidar);

/// Reads the scans of sequence.frames and sets the properties of the sensors that follow
/// from the scans.
/// @param files  [frames] point file of each frame
/// @param own  vehicle poses of the dataset, with which its motion compensation is undone
/// @throws DataError with file and point
void read_hdl32e_sweeps(Sequence& sequence, const std::vector<std::filesystem::path>& files,
                        const PoseTrack& own, const DatasetOptions& options);

}  // namespace relidar::nuscenes
