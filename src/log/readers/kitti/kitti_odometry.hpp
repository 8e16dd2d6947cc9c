// SPDX-License-Identifier: Apache-2.0
// Loads KITTI odometry. The folder sequences/NN contains velodyne/%06d.bin, calib.txt and
// times.txt. Poses are in poses.txt or in ../../poses/NN.txt. SemanticKITTI adds the
// classes of all points in labels/%06d.label.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// The scans are motion-compensated, so all rays of a scan have the same sensor pose. The
/// world frame is the LiDAR frame in frame 0.
/// @throws DataError with file and field
/// @throws UsageError if no scan is in the requested frame range
LidarSequence load_kitti_odometry(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
