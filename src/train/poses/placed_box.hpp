// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct PosedBox {
    Pose box_from_world;
    glm::dvec3 half_size_m;

    /// Distances at which a ray enters and leaves the box, at least 0, by the slab
    /// method. Entry > exit if the ray misses it.
    /// @param margin_m  enlarges the box on every side
    glm::dvec2 intersect_m(const WorldRay& ray, double margin_m = 0.0) const;
};

}  // namespace relidar
