// SPDX-License-Identifier: Apache-2.0
// Reader of KITTI raw. The folder <date>/<date>_drive_NNNN_sync contains velodyne_points,
// oxts and tracklet_labels.xml. The calibration is one folder above.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads the requested frames of a drive.
/// @param drive  folder with velodyne_points
/// @throws DataError with file and field
/// @throws UsageError if no scan is in the requested frame range
Sequence load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);

}  // namespace relidar
