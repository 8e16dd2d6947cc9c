// SPDX-License-Identifier: Apache-2.0
// GPS/IMU data (OXTS) in the format of KITTI.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/georeference.hpp>

namespace relidar::layouts {

/// Returns a line of 30 numbers for each pose. KITTI's development kit computes the same
/// poses from them, relative to the first one: Mercator coordinates, with the scale 1 at
/// the first latitude. Accelerations and angular rates are 0.
/// @param place  of the world of the poses. Empty: the first pose is at a fixed place
std::string format_oxts(const std::vector<Pose>& world_from_imu, const std::vector<double>& times_s,
                        const std::optional<Georeference>& place);

}  // namespace relidar::layouts
