// SPDX-License-Identifier: Apache-2.0
#include "train/poses/placed_box.hpp"

#include <algorithm>

#include "base/geometry/ray_box.hpp"

namespace relidar {

glm::dvec2 PosedBox::intersect_m(const WorldRay& ray, double margin_m) const {
    const glm::dvec3 o = box_from_world * ray.origin_m, d = box_from_world.rotation * ray.direction,
                     half_m = half_size_m + margin_m;
    const auto inside = cross_box(o, d, -half_m, half_m);
    return inside ? glm::dvec2(std::max(inside->enter, 0.0), inside->leave) : glm::dvec2(1.0, 0.0);
}

}  // namespace relidar
