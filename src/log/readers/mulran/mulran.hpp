// SPDX-License-Identifier: Apache-2.0
// MulRan, a sequence as it is distributed: scans of an OS1-64 in Ouster/ or
// sensor_data/Ouster/, poses in global_pose.csv.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are the scans in the order of time. The vehicle's frame is that of the poses;
/// the dataset's world is theirs.
/// @throws DataError naming file and line, UsageError where the asked range has no scan
Sequence load_mulran(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
