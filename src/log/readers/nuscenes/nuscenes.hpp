// SPDX-License-Identifier: Apache-2.0
// Loads nuScenes, MAN TruckScenes and Lyft Level 5. One subfolder contains the tables,
// and other subfolders contain the point files. Loads one scene with all its LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Loads the scene that DatasetOptions::sequence selects: by its name ("scene-0061"), by
/// the first characters of its name, or by its nuScenes number ("61"). The frames are the
/// keyframes and sweeps of the first LiDAR, sorted by time. Sweeps of other LiDARs at
/// nearly the same time get the same frame number. The world frame is the frame of the
/// dataset's poses.
/// @throws DataError with file, record and key
/// @throws UsageError if the scene or LiDAR is unknown, or if no sweep is in the
/// requested frame range
LidarSequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
