// SPDX-License-Identifier: Apache-2.0
// Reader of MulRan sequences as they are distributed: scans of an OS1-64 in Ouster/ or
// sensor_data/Ouster/, poses in global_pose.csv.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a sequence. Frames are the scans in order of time. The vehicle frame is the
/// frame of the poses, and the dataset's world is their world.
/// @throws DataError with file and line, UsageError if no scan is in the requested range
Sequence load_mulran(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
