// SPDX-License-Identifier: Apache-2.0
// Matches sweeps of several LiDARs that turn independently of each other.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

namespace relidar {

/// Returns the median time between sweeps of a LiDAR, or 0.1 s if there is only one
/// sweep.
double usual_step_s(std::vector<double> times_s);

/// Finds, for each sweep of the main LiDAR, the sweep of another LiDAR that is nearest in
/// time. No sweep is matched twice. The main LiDAR is the one that numbers the frames.
/// @param main_s  [sweeps] ascending, at least one
/// @param other_s  in any order
/// @param most_s  maximum time difference
/// @return [sweeps] indices in other_s
std::vector<std::optional<std::size_t>> match_sweeps(const std::vector<double>& main_s,
                                                     const std::vector<double>& other_s, double most_s);

}  // namespace relidar
