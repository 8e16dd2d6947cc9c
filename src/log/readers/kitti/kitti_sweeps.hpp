// SPDX-License-Identifier: Apache-2.0
// Reads the sweeps of an HDL-64E, which all KITTI datasets store in the same format. A
// file has the returns ring by ring. Dropped rays are not stored.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Reads the scan of every frame in a log and assigns its points to the rays that were
/// fired. Also sets the beams and columns of the LiDAR.
/// @param sequence  log with frame numbers, and with the period and range of its LiDAR
/// @param folder  folder with one scan file per frame
/// @param digits  number of digits in a file name, such as 10 in 0000000042.bin
/// @throws DataError with the file
void read_sweeps(Sequence& sequence, const std::filesystem::path& folder, int digits,
                 const DatasetOptions& options);

}  // namespace relidar::kitti
