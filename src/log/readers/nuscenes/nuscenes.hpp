// SPDX-License-Identifier: Apache-2.0
// Loads nuScenes, MAN TruckScenes and Lyft Level 5. One subfolder contains the tables,
// and other subfolders contain the point files. Loads one scene with all its LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// DatasetOptions::sequence selects a scene by its name ("scene-0061"), by its first
/// characters, or by its number ("61"). Frames are the keyframes and sweeps of the first
/// LiDAR, sorted by time. Sweeps of other LiDARs at nearly the same time share the
/// number. The world frame is that of the poses.
/// @throws DataError with file, record and key
/// @throws UsageError if the scene or LiDAR is unknown, or if no sweep is in the
/// requested frame range
LidarSequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
