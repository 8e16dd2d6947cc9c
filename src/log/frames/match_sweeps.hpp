// SPDX-License-Identifier: Apache-2.0
// Matches the sweeps of several LiDARs by time. The LiDARs are not synchronised.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

namespace relidar {

/// Returns the median time between consecutive sweeps; 0.1 s if there is only one.
double median_interval_s(std::vector<double> sweep_times_s);

/// Returns for each sweep of the main LiDAR the index of the nearest sweep of another
/// LiDAR. No sweep is assigned twice.
/// @param main_times_s  [sweeps] times of the main LiDAR, ascending, at least one
/// @param other_times_s  times of the other LiDAR in any order
std::vector<std::optional<std::size_t>> match_sweeps(const std::vector<double>& main_times_s,
                                                     const std::vector<double>& other_times_s,
                                                     double max_difference_s);

}  // namespace relidar
