// SPDX-License-Identifier: Apache-2.0
// Checks whether points come from a spinning LiDAR. Other LiDARs scan a window or a
// rosette pattern.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Returns the reason, or an empty string. In a spinning LiDAR, all points of a ring have
/// nearly the same elevation. A sweep takes the time of a full revolution, even if the
/// field of view is limited.
/// @param scans  some scans, with rings
/// @param frame_interval_s  time between scans in seconds
std::string explain_why_not_spinning(const std::vector<LidarPoints>& scans,
                                     const SpinningSensor& fitted_sensor, double frame_interval_s);

}  // namespace relidar
