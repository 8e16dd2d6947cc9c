// SPDX-License-Identifier: Apache-2.0
// Waymo Open, Perception 1.4: a segment is one .tfrecord file, a record of it one frame
// of up to five LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a segment. Frames are numbered by their records, from 0.
/// DatasetOptions::sequence is how a file's name begins, "segment-" left out or not, or a
/// name that the LiDAR-RT paper gives to a part of a segment (ws1 to ws4, wd1 to wd4),
/// which is of the LiDAR TOP alone.
/// @param path  a .tfrecord file, or a folder of them
/// @throws DataError naming file, record and field, UsageError for an unknown segment or
/// a range without frames
Sequence load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
