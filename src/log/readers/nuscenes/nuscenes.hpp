// SPDX-License-Identifier: Apache-2.0
// nuScenes, MAN TruckScenes and Lyft Level 5: a folder with tables in one of its folders
// and files in others. One scene, all its LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads the scene that DatasetOptions::sequence names, by its name, how it begins, or
/// nuScenes' number: "scene-0061", "61". Frames are keyframes and sweeps of the first
/// LiDAR in order; sweeps of others beside them share their numbers. The dataset's world
/// is that of its poses.
/// @throws DataError naming file, record and key; UsageError where there is no such scene
/// or LiDAR, or no sweep in the asked frame range
Sequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
