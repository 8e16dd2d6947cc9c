// SPDX-License-Identifier: Apache-2.0
// Finds the returns on the body that carries a LiDAR, which are no scenery.
#pragma once

#include <string>
#include <vector>

#include <relidar/log/log.hpp>

namespace relidar {

/// The body that carries a LiDAR, as the LiDAR sees it.
struct OwnBody {
    BodyTable table;     ///< empty: the log shows no body
    double share = 0.0;  ///< share of the returns that are on the body
    /// Returns a note with the share, the azimuths and the distance of the body.
    std::string describe() const;
};

/// Searches directions in which a LiDAR always measures the same short range. Ground and
/// walls can have constant ranges, too. But at the place of a body's point, nothing is
/// left when the sensor has moved on, so that rays from elsewhere pass through it.
/// Compares at least five places of the sensor that are 0.2 m apart, so a sensor that
/// stands shows no body.
/// @param frames  indices into Log::frames of the frames to use
OwnBody find_own_body(const Log& log, int lidar, const std::vector<int>& frames);

/// Removes the returns on Lidar::own_body from frames. BodyTable::hides() is true for
/// these rays, so that they are neither drops nor free space.
void hide_own_body(Log& log, const std::vector<int>& frames);

}  // namespace relidar
