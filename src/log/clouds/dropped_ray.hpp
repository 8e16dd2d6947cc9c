// SPDX-License-Identifier: Apache-2.0
// Defines which stored points and ranges are rays without a return. All readers of points
// use this definition, because programs store such rays in different ways.
#pragma once

#include <cmath>

#include <glm/glm.hpp>

namespace relidar {

/// Minimum range of a return. A nearer point has no direction.
inline constexpr float kNearestReturn_m = 1e-3f;

/// Returns true if a range is that of a return. A ray without a return has the range 0,
/// NaN, an infinite range, or a negative range such as -1.
inline bool is_return_range(double range_m) { return std::isfinite(range_m) && range_m > 0.0; }

/// Returns true if a point is a return. A ray without a return is stored as a point at
/// the sensor, or as a point with NaN or an infinite value in at least one coordinate.
template <class Vector>
bool is_return(const Vector& point_m) {
    return std::isfinite(point_m.x) && std::isfinite(point_m.y) && std::isfinite(point_m.z) &&
           glm::length(glm::dvec3(point_m)) >= double(kNearestReturn_m);
}

}  // namespace relidar
