// SPDX-License-Identifier: Apache-2.0
// Reader of KITTI odometry: sequences/NN with velodyne/%06d.bin, calib.txt, times.txt,
// and poses in poses.txt or in ../../poses/NN.txt.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a sequence. Its scans are motion-compensated, so there is no rolling shutter.
/// The dataset's world is the LiDAR of frame 0.
/// @throws DataError with file and field, UsageError if no scan is in the requested frame
/// range
Sequence load_kitti_odometry(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
