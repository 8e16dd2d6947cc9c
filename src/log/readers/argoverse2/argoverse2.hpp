// SPDX-License-Identifier: Apache-2.0
// Argoverse 2 sensor: a log folder with sensors/lidar/NS.feather,
// calibration/egovehicle_SE3_sensor.feather, city_SE3_egovehicle.feather,
// annotations.feather. Two VLP-32C, one on top of the other.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a log. Frames are numbered by the order of sweeps; both LiDARs of a sweep share
/// its number and time. The dataset's world is the city's frame.
/// @throws DataError naming file and column, UsageError where no sweep lies in the asked
/// frame range
Sequence load_argoverse2(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
