// SPDX-License-Identifier: Apache-2.0
// nuScenes: a folder with tables in v1.0-*/ and files in samples/ and sweeps/. One scene of it, LIDAR_TOP.
#pragma once

#include <filesystem>

#include <relidar/dataset.hpp>

namespace relidar {

/// Reads the scene that DatasetOptions::sequence names, by its name or its number: "scene-0061", "61". Frames are keyframes and sweeps in
/// order. The dataset's world is the map's frame.
/// @throws DataError naming file, record and key; UsageError where there is no such scene, or no sweep in the asked frame range
Sequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
