// SPDX-License-Identifier: Apache-2.0
// Computes the normals of a rendered range image, and their difference from blended
// surfel normals (docs/method.md M11), in double.
#pragma once

#include <optional>
#include <vector>

#include "render.hpp"

namespace relidar::reference {

/// Image of rendered rays, row by row.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    bool circular = false;       ///< the first column is next to the last one
    bool normalised = false;     ///< true: the range is D / W; false: D
    std::vector<Ray> rays;       ///< [rows,columns]
    std::vector<Pixel> pixels;   ///< [rows,columns] depth, weight and normal are used
    std::vector<bool> returned;  ///< [rows,columns] pixels without a return are ignored
};

/// Returns the normal N of each pixel that has one: unit length, facing the sensor.
std::vector<std::optional<glm::dvec3>> image_normals(const RangeImage& image);

/// Returns (W - B . N) / (number of returned rays) for each pixel with a normal, and 0
/// for others. The sum of these terms is a mean over the returned rays.
std::vector<double> normal_terms(const RangeImage& image,
                                 const std::vector<std::optional<glm::dvec3>>& normals);

}  // namespace relidar::reference
