// SPDX-License-Identifier: Apache-2.0
// Boreas, a sequence as it is distributed: lidar/, applanix/lidar_poses.csv,
// calib/T_applanix_lidar.txt.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are the scans in the order of time; the vehicle's frame is the LiDAR's, turned
/// so that x looks forward. The dataset's world is its East-North-Up frame.
/// @throws DataError naming file and line, UsageError where the asked range has no scan
Sequence load_boreas(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
