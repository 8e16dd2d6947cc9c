// SPDX-License-Identifier: Apache-2.0
// Detects clouds from which a program has removed points. Their rays must not be treated
// as dropped rays.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Tests whether a program has removed points from the scans. Returns the reason, or an
/// empty string for complete scans. In a complete ring, most azimuth steps between
/// neighbouring points are equal.
/// @param scans  some scans with rings; the rings may have been estimated
/// @param fitted_sensor  sensor that was fitted to these scans
std::string explain_removed_points(const std::vector<LidarPoints>& scans,
                                   const SpinningSensor& fitted_sensor);

}  // namespace relidar
