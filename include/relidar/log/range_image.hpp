// SPDX-License-Identifier: Apache-2.0
// Range images, and the rule that decides which of their pixels are returns.
#pragma once

#include <algorithm>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// A range image, measured or rendered, with the ray of each pixel.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    /// [rows*columns] metres along the ray. 0 if the ray was dropped (measured image) or
    /// hit nothing (rendered image).
    std::vector<float> range_m;
    std::vector<float> intensity;      ///< [rows*columns] intensity
    std::vector<float> drop_prob;      ///< [rows*columns] drop probability; 0 or 1 in a measured image
    std::vector<glm::vec3> origin;     ///< [rows*columns] start of the ray; metres, sensor frame
    std::vector<glm::vec3> direction;  ///< [rows*columns] unit vector, sensor frame
};

/// Drop probability at and above which a ray counts as dropped. Output files always use
/// this threshold; strict metrics use it by default.
inline constexpr float kDropThreshold = 0.5f;
/// Returns true if a ray counts as a return: it hit something, and its drop probability
/// is below kDropThreshold.
inline bool returned(float drop_prob, float range_m) { return drop_prob < kDropThreshold && range_m > 0.0f; }

/// Returns false if every pixel has intensity 0, because the log has no intensities.
inline bool has_intensities(const RangeImage& image) {
    return std::ranges::any_of(image.intensity, [](float intensity) { return intensity > 0.0f; });
}

}  // namespace relidar
