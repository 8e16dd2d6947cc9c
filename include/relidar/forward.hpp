// SPDX-License-Identifier: Apache-2.0
// Rays in, rendered range, intensity and ray-drop logits out (Eq. 2-4).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Direction in which spherical harmonics are evaluated.
enum class ShDirection { ray, surfel };

/// The constants of the image formation model, docs/method.md sections 2-3.
struct ImageModel {
    float near_m = 0.2f;                     ///< hits nearer than this are ignored
    float alpha_min = 1.0f / 255.0f;         ///< a surfel contributing less is skipped
    float alpha_max = 0.99f;                 ///< alpha is clamped to this (gradient zero where clamped)
    float transmittance_min = 1e-4f;         ///< a surfel that would bring T under this is not blended and ends the ray
    int sh_degree = 3;                       ///< active SH degree, 0..3
    ShDirection sh_direction = ShDirection::ray;
};

/// Rays in world coordinates.
struct WorldRays {
    std::vector<glm::vec3> origin;      ///< [n] metres
    std::vector<glm::vec3> direction;   ///< [n] unit
    std::size_t size() const { return direction.size(); }
};

/// What a ray brings back; one entry a ray.
struct Rendering {
    std::vector<float> depth;          ///< D = sum w t, not normalised, metres
    std::vector<float> weight;         ///< W = sum w
    std::vector<float> intensity;      ///< sum w * intensity
    std::vector<float> hit_logit;      ///< sum w * hit logit
    std::vector<float> drop_logit;     ///< sum w * drop logit + T * 1 (background)
    std::vector<float> transmittance;  ///< T after the last blended surfel
    std::vector<float> median_depth;   ///< t at which T crosses 0.5, 0 where it never does, metres
    std::vector<std::uint32_t> hits;   ///< blended surfels
    std::size_t size() const { return depth.size(); }
};

}  // namespace relidar
