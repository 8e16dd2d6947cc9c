// SPDX-License-Identifier: Apache-2.0
// Intersects lines with boxes by the slab method, and rays with spheres. Finds the
// longest side of a box.
#pragma once

#include <algorithm>
#include <limits>
#include <optional>
#include <utility>

#include <glm/glm.hpp>

namespace relidar {

/// Part of a line in a box: origin + t * direction, for t from enter to leave.
struct BoxCrossing {
    double enter = -std::numeric_limits<double>::infinity();
    double leave = std::numeric_limits<double>::infinity();
    int axis = 0;  ///< axis of the side through which the line enters
};

/// Returns no value if the line misses the box.
/// @param low, high  corners of the box, in the axes of the box
inline std::optional<BoxCrossing> cross_box(const glm::dvec3& origin, const glm::dvec3& direction,
                                            const glm::dvec3& low, const glm::dvec3& high) {
    BoxCrossing inside;
    for (int axis = 0; axis < 3; ++axis) {
        if (direction[axis] == 0.0) {
            // The line is parallel to these sides, so it must be between them.
            if (origin[axis] < low[axis] || origin[axis] > high[axis]) return {};
            continue;
        }
        double near = (low[axis] - origin[axis]) / direction[axis],
               far = (high[axis] - origin[axis]) / direction[axis];
        if (near > far) std::swap(near, far);
        if (near > inside.enter) {
            inside.enter = near;
            inside.axis = axis;
        }
        inside.leave = std::min(inside.leave, far);
    }
    if (inside.enter > inside.leave) return {};
    return inside;
}

/// Axis (0, 1 or 2) of the largest component. The first one if two are equal.
template <class Vector>
int longest_axis(const Vector& size) {
    if (size.x >= size.y && size.x >= size.z) return 0;
    return size.y >= size.z ? 1 : 2;
}

/// Returns true if a ray passes through a sphere, or begins in it.
inline bool passes_sphere(const glm::dvec3& origin_m, const glm::dvec3& direction, const glm::dvec3& centre_m,
                          double radius_m) {
    const glm::dvec3 to_centre_m = centre_m - origin_m;
    const double along_m = glm::dot(to_centre_m, direction);
    return along_m > -radius_m &&
           glm::dot(to_centre_m, to_centre_m) - along_m * along_m < radius_m * radius_m;
}

}  // namespace relidar
