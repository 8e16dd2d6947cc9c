// SPDX-License-Identifier: Apache-2.0
#include "train/poses/placed_box.hpp"

#include <algorithm>
#include <cmath>

namespace relidar {

/// Intersects the distances between the two planes of each axis (slab method). The
/// distances are empty, with entry > exit, if the ray misses the box.
glm::dvec2 PosedBox::intersect_m(const WorldRay& ray, double margin_m) const {
    const glm::dvec3 o = box_from_world * ray.origin_m, d = box_from_world.rotation * ray.direction,
                     half_m = half_size_m + margin_m;
    glm::dvec2 inside(0.0, 1e30);
    for (int axis = 0; axis < 3; ++axis) {
        if (std::abs(d[axis]) < 1e-12) {
            if (std::abs(o[axis]) > half_m[axis]) return {1.0, 0.0};
            continue;
        }
        const double a = (-half_m[axis] - o[axis]) / d[axis], b = (half_m[axis] - o[axis]) / d[axis];
        inside = {std::max(inside.x, std::min(a, b)), std::min(inside.y, std::max(a, b))};
    }
    return inside;
}

}  // namespace relidar
