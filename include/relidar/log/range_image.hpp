// SPDX-License-Identifier: Apache-2.0
// Range images, and the rule that decides which pixels of a range image count as returns.
#pragma once

#include <algorithm>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// A range image, measured or rendered, with the ray of each pixel.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    /// [rows*columns] metres along the ray; 0 if it was dropped (measured) or hit nothing
    /// (rendered)
    std::vector<float> range_m;
    std::vector<float> intensity;      ///< [rows*columns] intensity
    std::vector<float> drop_prob;      ///< [rows*columns] drop probability. It is 0 or 1 in a measured image.
    std::vector<glm::vec3> origin;     ///< [rows*columns] start of the ray; metres, sensor frame
    std::vector<glm::vec3> direction;  ///< [rows*columns] unit vector, sensor frame
};

/// A ray counts as dropped from this drop probability on: in output files, and by default
/// in the strict metrics.
inline constexpr float kDropThreshold = 0.5f;
/// Returns true if the ray hit something and is not dropped.
inline bool is_ray_returned(float drop_prob, float range_m) {
    return drop_prob < kDropThreshold && range_m > 0.0f;
}

/// Returns false if every pixel has intensity 0, because the log has no intensities.
inline bool has_intensities(const RangeImage& image) {
    return std::ranges::any_of(image.intensity, [](float intensity) { return intensity > 0.0f; });
}

}  // namespace relidar
