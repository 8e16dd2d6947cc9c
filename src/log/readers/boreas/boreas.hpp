// SPDX-License-Identifier: Apache-2.0
// Loads Boreas sequences in the published folder layout: lidar/, applanix/lidar_poses.csv
// and calib/T_applanix_lidar.txt.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are sorted by time. The vehicle frame is the LiDAR frame, rotated so that x
/// points forward. The world frame is East-North-Up.
/// @throws DataError with file and line
/// @throws UsageError if no scan is in the requested range
LidarSequence load_boreas_dataset(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
