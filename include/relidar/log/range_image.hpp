// SPDX-License-Identifier: Apache-2.0
// Range images, and which of their pixels are returns.
#pragma once

#include <algorithm>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// A range image, real or rendered, with the ray of each pixel.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    /// [rows*columns] along the ray; 0 where dropped (real) or wherever nothing was met
    std::vector<float> range_m;
    std::vector<float> intensity;      ///< [rows*columns]
    std::vector<float> drop_prob;      ///< [rows*columns] 0/1 for a real image
    std::vector<glm::vec3> origin;     ///< [rows*columns] metres, sensor frame
    std::vector<glm::vec3> direction;  ///< [rows*columns] unit, sensor frame
};

/// Drop probability from which a ray counts as dropped, in what is written and by default
/// in what is scored strictly.
inline constexpr float kDropThreshold = 0.5f;
/// Whether a ray counts as returned: it met something, and returns more likely than not.
inline bool returned(float drop_prob, float range_m) { return drop_prob < kDropThreshold && range_m > 0.0f; }

/// Returns false if every pixel has intensity 0, because the log has no intensities.
inline bool has_intensities(const RangeImage& image) {
    return std::ranges::any_of(image.intensity, [](float intensity) { return intensity > 0.0f; });
}

}  // namespace relidar
