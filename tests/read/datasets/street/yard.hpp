// SPDX-License-Identifier: Apache-2.0
// A yard of four walls without a roof. The hit of a ray has a closed form.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include <relidar/base/math.hpp>

namespace relidar::test {

/// The ground is at z = -0.35. The ray must start in the yard.
inline glm::dvec3 intersect_yard(const glm::dvec3& origin_m, const glm::dvec3& direction) {
    double t = std::numeric_limits<double>::infinity();
    const auto plane = [&](double from, double along, double at) {
        if (along != 0.0 && (at - from) / along > 0.0) t = std::min(t, (at - from) / along);
    };
    plane(origin_m.z, direction.z, -0.35);
    for (const double x : {-31.0, 42.0}) plane(origin_m.x, direction.x, x);
    for (const double y : {-24.0, 29.0}) plane(origin_m.y, direction.y, y);
    return origin_m + t * direction;
}

/// A single firing of a laser.
struct YardRay {
    double time_s = 0.0;
    glm::dvec3 direction{0.0};  ///< in the LiDAR's frame at the firing time
    glm::dvec3 origin_m{0.0};   ///< in the world, like point_m
    glm::dvec3 point_m{0.0};
    bool returned = false;
};

/// Casts a ray of a LiDAR into a yard, whose place in the world is `yard_m`.
inline YardRay cast_in_yard(double time_s, const Pose& world_from_lidar, const glm::dvec3& direction,
                            const glm::dvec3& yard_m) {
    const glm::dvec3& origin_m = world_from_lidar.translation;
    return {time_s, direction, origin_m,
            yard_m + intersect_yard(origin_m - yard_m, world_from_lidar.rotation * direction)};
}

/// Returns the unit vector with these angles.
inline glm::dvec3 direction_at(double elevation_rad, double azimuth_rad) {
    return {std::cos(elevation_rad) * std::cos(azimuth_rad), std::cos(elevation_rad) * std::sin(azimuth_rad),
            std::sin(elevation_rad)};
}

}  // namespace relidar::test
