// SPDX-License-Identifier: Apache-2.0
// Defines which stored points and ranges mean "ray without a return". Programs store such
// rays in different ways, so all readers of points use this definition.
#pragma once

#include <cmath>

#include <glm/glm.hpp>

namespace relidar {

/// Minimum range of a return. If the point is nearer, its direction is undefined.
inline constexpr float kNearestReturn_m = 1e-3f;

/// Returns true if a range belongs to a return. A ray without a return is stored with the
/// range 0, NaN, an infinite range, or a negative range such as -1.
inline bool is_return_range(double range_m) { return std::isfinite(range_m) && range_m > 0.0; }

/// Returns true if a point is a return. A ray without a return is stored as a point at
/// the sensor, or as a point with NaN or an infinite coordinate.
template <class Vector>
bool is_return(const Vector& point_m) {
    return std::isfinite(point_m.x) && std::isfinite(point_m.y) && std::isfinite(point_m.z) &&
           glm::length(glm::dvec3(point_m)) >= double(kNearestReturn_m);
}

}  // namespace relidar
