// SPDX-License-Identifier: Apache-2.0
// The sweeps of an HDL-64E as KITTI stores them, in all its datasets: points ring by
// ring, hits only.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar::kitti {

/// Reads the scan of every frame of a log and puts its points on the rays that were
/// fired; sets the beams and columns of its LiDAR.
/// @param sequence  its frames have their numbers, its LiDAR its period and range @param
/// folder  with a file a frame
/// @param digits  of the number in a file's name, as 10 of 0000000042.bin @throws
/// DataError naming the file
void read_sweeps(Sequence& sequence, const std::filesystem::path& folder, int digits,
                 const DatasetOptions& options);

}  // namespace relidar::kitti
