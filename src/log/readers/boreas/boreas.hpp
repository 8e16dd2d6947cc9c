// SPDX-License-Identifier: Apache-2.0
// Reader of Boreas sequences in their published layout: lidar/, applanix/lidar_poses.csv,
// calib/T_applanix_lidar.txt.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a sequence. Frames are the scans in order of time. The vehicle frame is the
/// LiDAR's frame, rotated so that x points forward. The world frame of the dataset is its
/// East-North-Up frame.
/// @throws DataError with file and line
/// @throws UsageError if no scan is in the requested range
Sequence load_boreas(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
