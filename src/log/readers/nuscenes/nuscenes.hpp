// SPDX-License-Identifier: Apache-2.0
// Reader of nuScenes, MAN TruckScenes and Lyft Level 5: a folder with the tables in one
// subfolder and the files in others. Reads one scene with all its LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads the scene in DatasetOptions::sequence, given by its name, a beginning of its
/// name, or nuScenes' number: "scene-0061", "61". Frames are the keyframes and sweeps of
/// the first LiDAR in order. Sweeps of other LiDARs at nearly the same time share its
/// numbers. The dataset's world is the frame of its poses.
/// @throws DataError with file, record and key; UsageError if the scene or LiDAR is
/// unknown, or if no sweep is in the requested frame range
Sequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
