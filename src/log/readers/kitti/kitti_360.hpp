// SPDX-License-Identifier: Apache-2.0
// Loads KITTI-360. The folder contains calibration/, data_3d_raw/DRIVE/velodyne_points,
// data_poses/DRIVE and data_3d_bboxes. It can contain several drives.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Loads one drive. The option DatasetOptions::sequence is the name of the drive's
/// folder, or the four digits in this name. It can also be a sequence name of the
/// LiDAR-RT paper (ks1 to ks4, kd1 to kd6), which means a part of drive 0000. The world
/// frame of the dataset has x east, y north and z up.
/// @param folder  folder that contains data_3d_raw
/// @throws DataError with file and field
/// @throws UsageError if the drive is unknown or no scan is in the requested range
LidarSequence load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

namespace kitti {

/// Reads the boxes of vehicles, people and cycles from data_3d_bboxes/*/DRIVE.xml. Boxes
/// are in the world frame of the dataset. A moving object has one label per frame. A
/// standing object has one pose, which is used for all frames of its part of the drive.
/// @param frames  frames of the log for which boxes are read
/// @throws DataError with object and field
std::vector<BoxTrack> read_kitti_360_boxes(const std::filesystem::path& label_file,
                                           const std::vector<LidarFrame>& frames);

}  // namespace kitti
}  // namespace relidar
