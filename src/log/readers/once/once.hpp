// SPDX-License-Identifier: Apache-2.0
// Loads ONCE sequences in the published folder layout: lidar_roof/MILLISECONDS.bin with
// scans, and NAME.json with calibration, poses and boxes.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are numbered in the order of the JSON file. The vehicle frame is the frame of
/// the LiDAR, rotated so that x points forward. The world frame is the LiDAR in the first
/// frame. Boxes are not loaded, because they have no track ids.
/// @throws DataError with file and field
/// @throws UsageError if no scan is in the requested range
LidarSequence load_once_dataset(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
