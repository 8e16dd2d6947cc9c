// SPDX-License-Identifier: Apache-2.0
// Reader of Waymo Open, Perception 1.4. One .tfrecord file is a segment. Each record of
// the file is a frame of up to five LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a segment. Frames have the numbers of their records, which start at 0.
/// DatasetOptions::sequence selects a file by the first characters of its name, with or
/// without "segment-". It can also be a sequence name from the LiDAR-RT paper (ws1 to
/// ws4, wd1 to wd4), which is a part of a segment. Such a part contains only the LiDAR
/// TOP.
/// @param path  a .tfrecord file, or a folder of such files
/// @throws DataError with file, record and field
/// @throws UsageError if the segment is unknown or no frame is in the requested range
Sequence load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
