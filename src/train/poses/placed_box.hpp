// SPDX-License-Identifier: Apache-2.0
// Represents a box at one point in time, and intersects rays with this box.
#pragma once

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct PosedBox {
    Pose box_from_world;
    glm::dvec3 half_size_m;

    /// Returns the distances along a ray at which it enters and leaves the box. Both are
    /// at least 0.
    /// @param margin_m  enlarges the box on every side
    /// @return entry and exit; entry > exit if the ray misses the box
    glm::dvec2 compute_ray_entry_exit_m(const WorldRay& ray, double margin_m = 0.0) const;
};

}  // namespace relidar
