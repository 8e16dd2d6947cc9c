// SPDX-License-Identifier: Apache-2.0
// Boxes of KITTI-360. The folder contains calibration/, data_poses/DRIVE,
// data_3d_raw/DRIVE/velodyne_points and data_3d_bboxes. It can contain several drives.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/read/dataset.hpp>

namespace relidar::kitti {

/// Reads vehicles, people and cycles from data_3d_bboxes/*/DRIVE.xml, in the world frame
/// of the dataset. A moving object has a label per frame. A standing object has one pose
/// for all frames of its part of the drive.
/// @throws DataError with object and field
std::vector<BoxTrack> read_360_boxes(const std::filesystem::path& label_file,
                                     const std::vector<Frame>& frames);

}  // namespace relidar::kitti
