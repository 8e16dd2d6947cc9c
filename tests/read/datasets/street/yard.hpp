// SPDX-License-Identifier: Apache-2.0
// A yard of four walls without a roof. The hit of a ray has a closed form.
#pragma once

#include <algorithm>
#include <limits>

#include <glm/glm.hpp>

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

}  // namespace relidar::test
