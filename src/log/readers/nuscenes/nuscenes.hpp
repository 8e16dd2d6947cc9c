// SPDX-License-Identifier: Apache-2.0
// Reader of nuScenes, MAN TruckScenes and Lyft Level 5. One subfolder contains the
// tables, others contain the files. Loads one scene with all its LiDARs.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads the scene that DatasetOptions::sequence selects. A scene is selected by its name
/// ("scene-0061"), the first characters of its name, or nuScenes' number ("61"). Frames
/// are the keyframes and sweeps of the first LiDAR in order of time. Sweeps of other
/// LiDARs at nearly the same time get the same frame number. The world frame of the
/// dataset is the frame of its poses.
/// @throws DataError with file, record and key
/// @throws UsageError if the scene or LiDAR is unknown, or if no sweep is in the
/// requested frame range
Sequence load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
