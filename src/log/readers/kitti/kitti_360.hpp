// SPDX-License-Identifier: Apache-2.0
// Loads KITTI-360. The folder contains calibration/, data_3d_raw/DRIVE/velodyne_points,
// data_poses/DRIVE and data_3d_bboxes. It can contain several drives.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// DatasetOptions::sequence is the name of the folder of a drive, its four digits, or a
/// part of drive 0000 in the LiDAR-RT paper (ks1 to ks4, kd1 to kd6). The world frame has
/// x east, y north and z up.
/// @param folder  contains data_3d_raw
/// @throws DataError with file and field
/// @throws UsageError if the drive is unknown or no scan is in the requested range
LidarSequence load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

namespace kitti {

/// Reads vehicles, people and cycles from data_3d_bboxes/*/DRIVE.xml, in the world frame
/// of the dataset. A moving object has a label per frame. A standing object has one pose
/// for all frames of its part of the drive.
/// @throws DataError with object and field
std::vector<BoxTrack> read_kitti_360_boxes(const std::filesystem::path& label_file,
                                           const std::vector<LidarFrame>& frames);

}  // namespace kitti
}  // namespace relidar
