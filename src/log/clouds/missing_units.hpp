// SPDX-License-Identifier: Apache-2.0
// Declares the estimation of units that sequence.json does not contain.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "log/clouds/folder_head.hpp"

namespace relidar::folder {

/// Number of scans per LiDAR that are used to estimate units and beams.
inline constexpr std::size_t kSampleScans = 6;

/// Estimates the units that are not known, from the points of some scans. If several
/// intensity scales are possible, sets none. Intensities above 1 are then an error.
void estimate_missing_point_units(PointFileUnits& units, const std::vector<std::filesystem::path>& scan_files,
                                  Notes& notes);

}  // namespace relidar::folder
