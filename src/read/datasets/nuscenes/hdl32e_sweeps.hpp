// SPDX-License-Identifier: Apache-2.0
// Reads the sweeps of nuScenes. A file contains one revolution of an HDL-32E, column by
// column in the order of time. The LiDAR rotates clockwise. The dataset has moved all
// points to the end of the revolution (motion compensation).
#pragma once

#include <array>
#include <filesystem>
#include <vector>

#include <relidar/read/dataset.hpp>

namespace relidar::nuscenes {

/// Returns true if the first 32 points of a file have different rings, as a column of an
/// HDL-32E. Also returns true for a file without 32 points.
bool is_hdl32e_file(const std::filesystem::path& file);

/// Returns the LiDAR of nuScenes, an HDL-32E. Rotates its pose by 90 degrees, because x
/// points to the right in nuScenes and forward in relidar.
/// @param ego_from_lidar  pose of the LiDAR in the convention of nuScenes
Lidar make_hdl32e(const Pose& ego_from_lidar);

struct SweepFiles {
    std::filesystem::path points;
    /// category index of each point, one byte per point; empty without labels
    std::filesystem::path categories;
};

/// Reads the scans of all frames. Also sets the sensor properties that follow from the
/// scans.
/// @param sweep_files  [frames]
/// @param class_of_category  class of each category index
/// @param vehicle_track  used to undo the motion compensation
/// @throws DataError that names the file and the point
void read_hdl32e_sweeps(Log& log, const std::vector<SweepFiles>& sweep_files,
                        const std::array<SurfaceClass, 256>& class_of_category,
                        const PoseTrack& vehicle_track, const DatasetOptions& options);

}  // namespace relidar::nuscenes
