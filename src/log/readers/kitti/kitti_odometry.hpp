// SPDX-License-Identifier: Apache-2.0
// KITTI odometry: sequences/NN with velodyne/%06d.bin, calib.txt, times.txt; poses.txt
// there or poses/NN.txt beside sequences.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a sequence. Its scans are motion-compensated: there is no rolling shutter. The
/// dataset's world is the LiDAR of frame 0.
/// @throws DataError naming file and field, UsageError where no scan lies in the asked
/// frame range
Sequence load_kitti_odometry(const std::filesystem::path& folder, const DatasetOptions& options);

}  // namespace relidar
