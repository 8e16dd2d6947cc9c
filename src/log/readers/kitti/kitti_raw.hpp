// SPDX-License-Identifier: Apache-2.0
// Loads KITTI raw drives. The folder <date>/<date>_drive_NNNN_sync contains
// velodyne_points, oxts and tracklet_labels.xml. The calibration is in the folder above.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// @param drive  contains velodyne_points
/// @throws DataError with file and field
/// @throws UsageError if no scan is in the requested frame range
LidarSequence load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);

}  // namespace relidar
