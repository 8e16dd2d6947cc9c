// SPDX-License-Identifier: Apache-2.0
// Under which angle the rays of a range image meet what they meet, from the pixels
// around.
#pragma once

#include <cmath>
#include <span>

#include <glm/glm.hpp>

namespace relidar {

/// Rays of an image, row by row, columns going round, and how far each came.
struct ImageRays {
    int rows, columns;
    std::span<const glm::vec3> origin, direction;  ///< [rows*columns]
    std::span<const float> range_m;                ///< [rows*columns], 0 where nothing came back

    glm::dvec3 point(std::size_t i) const {
        return glm::dvec3(origin[i]) + double(range_m[i]) * glm::dvec3(direction[i]);
    }
};

/// Columns to either side that incidence_cosine() looks at.
inline constexpr std::size_t kIncidenceColumns = 4;

/// Cosine of the angle of incidence at pixel i, from the points four columns to either
/// side, so that centimetres of noise do not tilt it, and from the rows above and below.
/// @return below 0 where one of them is missing or lies on another surface
inline double incidence_cosine(const ImageRays& image, std::size_t i) {
    constexpr std::size_t kColumns = kIncidenceColumns;
    constexpr double kSameSurface = 0.2;  // of the range
    const auto columns = std::size_t(image.columns), row = i / columns, column = i % columns;
    if (columns < 2 * kColumns + 1 || row == 0 || row + 1 >= std::size_t(image.rows) ||
        !(image.range_m[i] > 0.0f))
        return -1.0;
    const std::size_t left = row * columns + (column + columns - kColumns) % columns,
                      right = row * columns + (column + kColumns) % columns;
    const std::size_t around[] = {right, left, i - columns, i + columns};
    for (const std::size_t k : around)
        if (!(image.range_m[k] > 0.0f) ||
            std::abs(image.range_m[k] - image.range_m[i]) > kSameSurface * double(image.range_m[i]))
            return -1.0;
    const glm::dvec3 normal = glm::cross(image.point(around[0]) - image.point(around[1]),
                                         image.point(around[2]) - image.point(around[3]));
    const double length = glm::length(normal);
    return length > 0.0 ? std::abs(glm::dot(normal / length, glm::dvec3(image.direction[i]))) : -1.0;
}

}  // namespace relidar
