// SPDX-License-Identifier: Apache-2.0
// KITTI raw: <date>/<date>_drive_NNNN_sync with velodyne_points, oxts,
// tracklet_labels.xml; calibration one folder up.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads the frames of a drive. @param drive folder with velodyne_points
/// @throws DataError naming file and field, UsageError where no scan lies in the asked
/// frame range
Sequence load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);

}  // namespace relidar
