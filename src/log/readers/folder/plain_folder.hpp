// SPDX-License-Identifier: Apache-2.0
// Loads plain folders, which contain sequence.json, poses.txt, boxes.json and scans.
// Users write such folders from their own logs. `relidar convert` creates them from any
// supported format.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads sequence.json, poses.txt, boxes.json and scans.
/// @throws DataError that names the file and the field
LidarSequence load_plain_folder(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
