// SPDX-License-Identifier: Apache-2.0
// Angle between the rays of a range image and the surface normals.
#pragma once

#include <cmath>
#include <span>

#include <glm/glm.hpp>

namespace relidar {

struct RangeImageRays {
    int rows, columns;
    std::span<const glm::vec3> origin, direction;
    std::span<const float> range_m;  ///< Measured ranges, [rows*columns]. 0 for rays without a return.
    bool circular = true;  ///< True if the columns cover a full turn, so that the last precedes the first.

    glm::dvec3 pixel_point_m(std::size_t pixel_index) const {
        return glm::dvec3(origin[pixel_index]) +
               double(range_m[pixel_index]) * glm::dvec3(direction[pixel_index]);
    }
};

/// Distance in columns of the pixels that incidence compares.
inline constexpr std::size_t kIncidenceColumns = 4;

/// Returns the cosine of the angle of incidence at a pixel. Uses the points one row above
/// and below, and kIncidenceColumns left and right, which reduces the effect of range
/// noise. Returns a negative value if one of these points is missing or on another
/// surface.
inline double incidence_cosine(const RangeImageRays& image, std::size_t pixel_index) {
    constexpr std::size_t kColumnOffset = kIncidenceColumns;
    // Maximum relative difference between the ranges of two pixels on the same surface.
    constexpr double kSameSurface = 0.2;
    const auto columns = std::size_t(image.columns), row = pixel_index / columns,
               column = pixel_index % columns;
    if (columns < 2 * kColumnOffset + 1 || row == 0 || row + 1 >= std::size_t(image.rows) ||
        !(image.range_m[pixel_index] > 0.0f) ||
        (!image.circular && (column < kColumnOffset || column + kColumnOffset >= columns)))
        return -1.0;
    const std::size_t left = row * columns + (column + columns - kColumnOffset) % columns,
                      right = row * columns + (column + kColumnOffset) % columns;
    const std::size_t around[] = {right, left, pixel_index - columns, pixel_index + columns};
    for (const std::size_t k : around)
        if (!(image.range_m[k] > 0.0f) || std::abs(image.range_m[k] - image.range_m[pixel_index]) >
                                              kSameSurface * double(image.range_m[pixel_index]))
            return -1.0;
    const glm::dvec3 normal = glm::cross(image.pixel_point_m(around[0]) - image.pixel_point_m(around[1]),
                                         image.pixel_point_m(around[2]) - image.pixel_point_m(around[3]));
    const double length = glm::length(normal);
    return length > 0.0 ? std::abs(glm::dot(normal / length, glm::dvec3(image.direction[pixel_index])))
                        : -1.0;
}

}  // namespace relidar
