// SPDX-License-Identifier: Apache-2.0
// Computes in double the normals of a rendered range image, and how much blended surfel
// normals differ from them (docs/method.md M11).
#pragma once

#include <optional>
#include <vector>

#include "render.hpp"

namespace relidar::reference {

/// Rendered rays as an image, row by row.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    bool circular = false;       ///< the first column follows the last one
    bool normalised = false;     ///< true: the range is D / W; false: D
    std::vector<Ray> rays;       ///< [rows,columns]
    std::vector<Pixel> pixels;   ///< [rows,columns] depth, weight and normal are used
    std::vector<bool> returned;  ///< [rows,columns] false: the pixel is ignored
};

/// Computes the normal N of each pixel that has one: a unit vector facing the sensor.
std::vector<std::optional<glm::dvec3>> image_normals(const RangeImage& image);

/// Returns (W - B . N) / (number of returned rays) for each pixel with a normal,
/// otherwise 0. The sum of the terms is a mean over the returned rays.
std::vector<double> normal_terms(const RangeImage& image,
                                 const std::vector<std::optional<glm::dvec3>>& normals);

}  // namespace relidar::reference
