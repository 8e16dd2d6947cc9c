// SPDX-License-Identifier: Apache-2.0
// Loads Waymo Open, Perception 1.4. One .tfrecord file is a segment. Each record of the
// file is a frame with up to five LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// A frame number is the index of the record. DatasetOptions::sequence selects a file by
/// the first characters of its name, with or without "segment-", or a part of a segment
/// with only TOP in the LiDAR-RT paper (ws1 to ws4, wd1 to wd4).
/// @param path  a .tfrecord file, or a folder of such files
/// @throws DataError with file, record and field
/// @throws UsageError if the segment is unknown or no frame is in the requested range
LidarSequence load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
