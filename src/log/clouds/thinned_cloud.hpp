// SPDX-License-Identifier: Apache-2.0
// Detects clouds from which a program has removed points. Their rays must not be treated
// as dropped rays.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Tests whether points were removed from the scans, for example by a filter. This is
/// likely if few rays have a return, or if the azimuth steps between the points of a ring
/// are uneven. Returns the reason, or an empty string if the scans seem complete.
/// @param scans  some scans with rings; the rings may have been estimated
/// @param fitted_sensor  sensor that was fitted to these scans
std::string explain_removed_points(const std::vector<LidarPoints>& scans,
                                   const SpinningSensor& fitted_sensor);

}  // namespace relidar
