// SPDX-License-Identifier: Apache-2.0
// Reader of Waymo Open, Perception 1.4. A segment is one .tfrecord file. Each record is
// one frame of up to five LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a segment. Frames are numbered by their records, from 0.
/// DatasetOptions::sequence is the beginning of a file name, with or without "segment-",
/// or a name from the LiDAR-RT paper for a part of a segment (ws1 to ws4, wd1 to wd4).
/// Such a part contains only the LiDAR TOP.
/// @param path  a .tfrecord file, or a folder of such files
/// @throws DataError with file, record and field, UsageError if the segment is unknown or
/// no frame is in the range
Sequence load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
