// SPDX-License-Identifier: Apache-2.0
// Reader of HDL-64E sweeps in the format of all KITTI datasets: points ring by ring,
// without dropped rays.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Reads the scan of every frame of a log and assigns its points to the fired rays. Sets
/// the beams and columns of the LiDAR.
/// @param sequence  log with frame numbers, and with period and range of its LiDAR
/// @param folder  folder with one file per frame
/// @param digits  number of digits in a file name, such as 10 in 0000000042.bin
/// @throws DataError with the file
void read_sweeps(Sequence& sequence, const std::filesystem::path& folder, int digits,
                 const DatasetOptions& options);

}  // namespace relidar::kitti
