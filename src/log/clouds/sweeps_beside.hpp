// SPDX-License-Identifier: Apache-2.0
// Logs of several LiDARs that turn on their own: which sweeps go together.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

namespace relidar {

/// Median step of a LiDAR's sweeps; 0.1 s where there is one alone.
double usual_step_s(std::vector<double> times_s);

/// For each sweep of the LiDAR that numbers the frames the nearest sweep of another one,
/// which goes with one of them at most.
/// @param main_s  [sweeps] ascending, at least one @param other_s  in any order
/// @param most_s  how far apart they may be @return [sweeps] positions in other_s
std::vector<std::optional<std::size_t>> sweeps_beside(const std::vector<double>& main_s,
                                                      const std::vector<double>& other_s, double most_s);

}  // namespace relidar
