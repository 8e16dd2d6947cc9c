// SPDX-License-Identifier: Apache-2.0
// Cells of a grid over the world as numbers, for hashing and sorting.
#pragma once

#include <cmath>
#include <cstdint>

#include <glm/glm.hpp>

namespace relidar {

/// Cell of a cubic grid that a point lies in, 21 bits an axis: no two cells within 2^20
/// cells of the origin share a key.
/// @param point_m [3] metres @param cell_m edge of the cells, metres
inline std::uint64_t cell_key(const glm::dvec3& point_m, double cell_m) {
    std::uint64_t key = 0;
    for (int axis = 0; axis < 3; ++axis)
        key = key << 21 | (std::uint64_t(std::int64_t(std::floor(point_m[axis] / cell_m))) & 0x1FFFFFu);
    return key;
}

}  // namespace relidar
