// SPDX-License-Identifier: Apache-2.0
#include "geometry_loss.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::reference {
namespace {

double range_of(const RangeImage& image, int i) {
    const Pixel& p = image.pixels[std::size_t(i)];
    return image.normalised ? p.depth / p.weight : p.depth;
}

/// Returns the index of the pixel `down` rows and `right` columns from pixel i, if it has
/// a surface.
std::optional<int> surface_beside(const RangeImage& image, int i, int down, int right) {
    const int row = i / image.columns + down;
    int column = i % image.columns + right;
    if (image.circular) column = (column + image.columns) % image.columns;
    if (row < 0 || row >= image.rows || column < 0 || column >= image.columns) return std::nullopt;
    const int j = row * image.columns + column;
    const bool surface = image.returned[std::size_t(j)] && image.pixels[std::size_t(j)].weight > 0.5 &&
                         range_of(image, j) > 0.0;
    return surface ? std::optional(j) : std::nullopt;
}

glm::dvec3 point(const RangeImage& image, int i) {
    return image.rays[std::size_t(i)].origin + range_of(image, i) * image.rays[std::size_t(i)].direction;
}

/// Returns the vector from the previous to the next pixel along a row or a column, if
/// these and pixel i belong to one surface.
std::optional<glm::dvec3> tangent(const RangeImage& image, int i, int down, int right) {
    const std::optional<int> before = surface_beside(image, i, -down, -right),
                             behind = surface_beside(image, i, down, right);
    if (!before || !behind) return std::nullopt;
    const double r = range_of(image, i),
                 bend = r / range_of(image, *before) + r / range_of(image, *behind) - 2.0;
    if (std::abs(bend) >= 0.1) return std::nullopt;
    return point(image, *behind) - point(image, *before);
}

}  // namespace

std::vector<std::optional<glm::dvec3>> image_normals(const RangeImage& image) {
    std::vector<std::optional<glm::dvec3>> normals(image.pixels.size());
    for (int i = 0; i < image.rows * image.columns; ++i) {
        if (!surface_beside(image, i, 0, 0)) continue;
        const std::optional<glm::dvec3> across = tangent(image, i, 0, 1), down = tangent(image, i, 1, 0);
        if (!across || !down ||
            glm::length(glm::cross(*across, *down)) <= 0.05 * glm::length(*across) * glm::length(*down))
            continue;
        const glm::dvec3 n = glm::normalize(glm::cross(*across, *down));
        normals[std::size_t(i)] = glm::dot(n, image.rays[std::size_t(i)].direction) > 0.0 ? -n : n;
    }
    return normals;
}

std::vector<double> normal_terms(const RangeImage& image,
                                 const std::vector<std::optional<glm::dvec3>>& normals) {
    const double n_returned = double(std::count(image.returned.begin(), image.returned.end(), true));
    std::vector<double> terms(image.pixels.size(), 0.0);
    for (std::size_t i = 0; i < terms.size(); ++i)
        if (normals[i])
            terms[i] = (image.pixels[i].weight - glm::dot(image.pixels[i].normal, *normals[i])) / n_returned;
    return terms;
}

}  // namespace relidar::reference
