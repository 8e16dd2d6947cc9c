// SPDX-License-Identifier: Apache-2.0
// Normals of a rendered range image and the disagreement of blended surfel normals with
// them (docs/method.md M11), in double.
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
    bool normalised = false;     ///< the range is D / W, else D
    std::vector<Ray> rays;       ///< [rows,columns]
    std::vector<Pixel> pixels;   ///< [rows,columns] depth, weight and normal are used
    std::vector<bool> returned;  ///< [rows,columns] others take no part
};

/// N of each pixel that has one: unit, facing the sensor.
std::vector<std::optional<glm::dvec3>> image_normals(const RangeImage& image);

/// W - B . N of each pixel with a normal, 0 elsewhere, over the number of returned rays:
/// the terms of a mean over them.
std::vector<double> normal_terms(const RangeImage& image,
                                 const std::vector<std::optional<glm::dvec3>>& normals);

}  // namespace relidar::reference
