// SPDX-License-Identifier: Apache-2.0
// Loads Argoverse 2 sensor logs. A log is a folder with sensors/lidar/NS.feather,
// calibration/egovehicle_SE3_sensor.feather, city_SE3_egovehicle.feather and
// annotations.feather. The vehicle has two VLP-32C, one above the other.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Frames are numbered in the order of the sweeps. Both LiDARs of a sweep share number
/// and time. The world frame is the city frame of the dataset.
/// @throws DataError with file and column
/// @throws UsageError if no sweep is in the requested frame range
LidarSequence load_argoverse2(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
