// SPDX-License-Identifier: Apache-2.0
// Defines which stored points and ranges mean "ray without a return". All readers of
// points use this definition, because programs store such rays in different ways. Some
// drivers and simulators store them as points at the maximum range of the sensor.
#pragma once

#include <cmath>

#include <glm/glm.hpp>

#include <relidar/log/log.hpp>

namespace relidar {

/// A nearer point has no reliable direction.
inline constexpr float kNearestReturn_m = 1e-3f;

/// Maximum number of returns of a ray. Real sensors have two or three.
inline constexpr std::size_t kMostReturns = 8;

/// Files store rays without a return with the range 0, NaN, infinity, or below 0.
inline bool is_return_range(double range_m) { return std::isfinite(range_m) && range_m > 0.0; }

/// Files store rays without a return at the sensor, or with NaN or infinite coordinates.
template <class Vector>
bool is_return_point(const Vector& point_m) {
    return std::isfinite(point_m.x) && std::isfinite(point_m.y) && std::isfinite(point_m.z) &&
           glm::length(glm::dvec3(point_m)) >= double(kNearestReturn_m);
}

/// Turns returns at the maximum range of a LiDAR into dropped rays and adds a note. Real
/// ranges have noise. The largest range of the log stands for dropped rays if it is a
/// multiple of half a metre, and exactly that of many returns, but not of nearly all.
void remove_drop_markers(Log& log);

}  // namespace relidar
