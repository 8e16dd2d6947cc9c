// SPDX-License-Identifier: Apache-2.0
// Loads MulRan sequences in the published folder layout. Scans of an OS1-64 are in
// Ouster/ or sensor_data/Ouster/. Poses are in global_pose.csv.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are sorted by time. Vehicle frame and world frame are those of global_pose.csv.
/// @throws DataError with file and line
/// @throws UsageError if no scan is in the requested range
LidarSequence load_mulran_dataset(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
