// SPDX-License-Identifier: Apache-2.0
// Converts the cells of a world grid to integer keys for hashing and sorting.
#pragma once

#include <cmath>
#include <cstdint>

#include <glm/glm.hpp>

namespace relidar {

/// Returns the key of the cubic grid cell that contains a point. A key has 21 bits per
/// axis, so keys are unique only within 2^20 cells of the origin.
inline std::uint64_t grid_key(const glm::dvec3& point_m, double cell_size_m) {
    std::uint64_t key = 0;
    for (int axis = 0; axis < 3; ++axis)
        key = key << 21 | (std::uint64_t(std::int64_t(std::floor(point_m[axis] / cell_size_m))) & 0x1FFFFFu);
    return key;
}

}  // namespace relidar
