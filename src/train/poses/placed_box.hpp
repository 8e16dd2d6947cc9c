// SPDX-License-Identifier: Apache-2.0
// A box at one moment, and where rays are inside of it.
#pragma once

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct PlacedBox {
    Pose box_from_world;
    glm::dvec3 half_size_m;

    /// Distances along a ray, from 0 on, between which it is inside of the box grown on
    /// every side. @return entry > exit where it misses
    glm::dvec2 interval(const WorldRay& ray, double grown_m = 0.0) const;
};

}  // namespace relidar
