// SPDX-License-Identifier: Apache-2.0
// Reader of KITTI-360: a folder with calibration/, data_3d_raw/DRIVE/velodyne_points,
// data_poses/DRIVE and data_3d_bboxes, for several drives.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads one drive. DatasetOptions::sequence is the name of its folder, the four digits
/// in that name, or a name from the LiDAR-RT paper for a part of drive 0000 (ks1 to ks4,
/// kd1 to kd6). The dataset's world: x east, y north, z up.
/// @param folder  folder with data_3d_raw
/// @throws DataError with file and field, UsageError if the drive is unknown or no scan
/// is in the range
Sequence load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

namespace kitti {

/// Reads the boxes of movable objects (vehicles, people, cycles) from
/// data_3d_bboxes/*/DRIVE.xml, in the dataset's world. Moving objects are labelled per
/// frame. Static objects have the same pose in every frame of the part of the drive in
/// which they were labelled.
/// @param frames  frames that are read
/// @throws DataError with object and field
std::vector<BoxTrack> read_360_boxes(const std::filesystem::path& file, const std::vector<Frame>& frames);

}  // namespace kitti
}  // namespace relidar
