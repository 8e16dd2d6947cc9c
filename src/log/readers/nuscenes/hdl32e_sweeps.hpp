// SPDX-License-Identifier: Apache-2.0
// Reads the sweeps of nuScenes. A file contains one revolution of an HDL-32E, column by
// column in the order of time. The LiDAR rotates clockwise. The dataset has moved all
// points to the end of the revolution (motion compensation).
#pragma once

#include <array>
#include <filesystem>
#include <vector>

#include <relidar/log/dataset.hpp>

namespace relidar::nuscenes {

/// Returns the LiDAR of nuScenes, an HDL-32E. Rotates its pose by 90 degrees, because x
/// points to the right in nuScenes and forward in relidar's sensor frame.
/// @param ego_from_lidar  pose of the LiDAR in the convention of nuScenes
Lidar make_hdl32e_lidar(const Pose& ego_from_lidar);

struct SweepFiles {
    std::filesystem::path points;
    /// File with the category index of each point, one byte per point. Empty if the
    /// points have no labels.
    std::filesystem::path categories;
};

/// Reads the scans of all frames in sequence.frames. Also sets the sensor properties that
/// can be computed from the scans.
/// @param sweep_files  [frames] files of each frame
/// @param class_of_category  class of each category index
/// @param vehicle_track  vehicle poses, used to undo the motion compensation of the
/// points
/// @throws DataError that names the file and the point
void read_hdl32e_sweeps(LidarSequence& sequence, const std::vector<SweepFiles>& sweep_files,
                        const std::array<SurfaceClass, 256>& class_of_category,
                        const PoseTrack& vehicle_track, const DatasetOptions& options);

}  // namespace relidar::nuscenes
