// SPDX-License-Identifier: Apache-2.0
// ONCE, a sequence as it is distributed: lidar_roof/MILLISECONDS.bin and NAME.json with
// calibration, poses and boxes.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are numbered as the JSON file lists them; the vehicle's frame is the LiDAR's,
/// turned so that x looks forward. The dataset's world is its LiDAR's frame in the first
/// frame. Boxes are not read: they have no identity.
/// @throws DataError naming file and field, UsageError where the asked range has no scan
Sequence load_once(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
