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
    /// [rows*columns] range in metres along the ray. The value is 0 if the ray was
    /// dropped (measured image) or if it hit nothing (rendered image).
    std::vector<float> range_m;
    std::vector<float> intensity;      ///< [rows*columns] intensity
    std::vector<float> drop_prob;      ///< [rows*columns] drop probability. It is 0 or 1 in a measured image.
    std::vector<glm::vec3> origin;     ///< [rows*columns] start of the ray; metres, sensor frame
    std::vector<glm::vec3> direction;  ///< [rows*columns] unit vector, sensor frame
};

/// Threshold of the drop probability. A ray counts as dropped if its drop probability is
/// at least this threshold. Output files always use this threshold. It is the default of
/// the strict metrics.
inline constexpr float kDropThreshold = 0.5f;
/// Returns true if a ray counts as a return. The ray must have hit something, and its
/// drop probability must be below kDropThreshold.
inline bool is_ray_returned(float drop_prob, float range_m) {
    return drop_prob < kDropThreshold && range_m > 0.0f;
}

/// Returns false if every pixel has intensity 0. This is the case if the log has no
/// intensities.
inline bool has_intensities(const RangeImage& image) {
    return std::ranges::any_of(image.intensity, [](float intensity) { return intensity > 0.0f; });
}

}  // namespace relidar
