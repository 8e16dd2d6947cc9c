// SPDX-License-Identifier: Apache-2.0
// KITTI-360: a folder with calibration/, data_3d_raw/DRIVE/velodyne_points,
// data_poses/DRIVE and data_3d_bboxes, several drives in it.
#pragma once

#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads one drive. DatasetOptions::sequence is the name of its folder, the four digits
/// in it, or a name that the LiDAR-RT paper gives to a part of drive 0000 (ks1 to ks4,
/// kd1 to kd6). The dataset's world: x east, y north, z up.
/// @param folder  with data_3d_raw @throws DataError naming file and field, UsageError
/// for an unknown drive or a range without scans
Sequence load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

namespace kitti {

/// Boxes of data_3d_bboxes/*/DRIVE.xml in the dataset's world, of what can move
/// (vehicles, people, cycles): those labelled at a frame, and standing ones, which have
/// the same pose at every frame of the part of the drive they were labelled in.
/// @param frames  the frames that are read @throws DataError naming object and field
std::vector<BoxTrack> read_360_boxes(const std::filesystem::path& file, const std::vector<Frame>& frames);

}  // namespace kitti
}  // namespace relidar
