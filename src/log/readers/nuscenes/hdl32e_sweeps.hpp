// SPDX-License-Identifier: Apache-2.0
// Reads the sweeps of nuScenes. A file contains one revolution of an HDL-32E, column by
// column in the order of time. The LiDAR rotates clockwise. The dataset has moved all
// points to the end of the revolution (motion compensation).
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::nuscenes {

/// Returns the LiDAR of nuScenes, an HDL-32E. Rotates its pose by 90 degrees, because x
/// points to the right in nuScenes and forward in relidar's sensor frame.
/// @param ego_from_lidar  pose of the LiDAR in the convention of nuScenes
Lidar make_hdl32e(const Pose& ego_from_lidar);

/// Reads the scans of all frames, and computes sensor properties from the scans.
/// @param files  [frames] file with the points of each frame
/// @param vehicle_track vehicle poses of the dataset, for undoing its motion compensation
/// @throws DataError with file and point
void read_hdl32e_sweeps(Sequence& sequence, const std::vector<std::filesystem::path>& files,
                        const PoseTrack& vehicle_track, const DatasetOptions& options);

}  // namespace relidar::nuscenes
