// SPDX-License-Identifier: Apache-2.0
// Detects clouds from which a program has removed points. Their rays must not be treated
// as dropped rays.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Returns the reason, or an empty string. Points were probably removed, for example by a
/// filter, if few rays have a return, or if the azimuth steps between the points of a
/// ring are uneven.
/// @param scans  some scans with rings; the rings may have been estimated
std::string explain_removed_points(const std::vector<LidarPoints>& scans,
                                   const SpinningSensor& fitted_sensor);

}  // namespace relidar
