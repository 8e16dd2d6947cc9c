// SPDX-License-Identifier: Apache-2.0
// Reads sweeps in the format of all KITTI datasets. A file of an HDL-64E contains the
// returns ring by ring. It does not contain dropped rays.
#pragma once

#include <filesystem>

#include <relidar/log/log.hpp>
#include <relidar/read/dataset.hpp>

namespace relidar::kitti {

/// Assigns the points of each scan to the rays that were fired. Sets the LiDAR except its
/// period.
/// @param log  log with frame numbers
/// @param file_name_digits  for example 10 in 0000000042.bin
/// @param label_folder  empty if the points have no labels
/// @throws DataError with the file
void read_hdl64_sweeps(Log& log, const std::filesystem::path& scan_folder, int file_name_digits,
                       const DatasetOptions& options, const std::filesystem::path& label_folder = {});

/// Reads scans of the same format from any LiDAR. The points of other LiDARs than an
/// HDL-64E are motion-compensated.
/// @param hdl64_is_moved  true if the points of an HDL-64E are motion-compensated
void read_kitti_sweeps(Log& log, const std::filesystem::path& scan_folder, const DatasetOptions& options,
                       bool hdl64_is_moved, const std::filesystem::path& label_folder = {});

}  // namespace relidar::kitti
