// SPDX-License-Identifier: Apache-2.0
// Makes random gradients of the loss with respect to the rendered outputs of rays.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "../reference/render.hpp"

namespace relidar::test {

/// Rendered outputs that get a non-zero gradient.
enum class Outputs { image, normal, distortion, likelihood, all };

/// Returns random gradients of `n` rays, rounded to float so that a kernel can receive
/// exactly the same values.
inline std::vector<reference::PixelGradient> random_upstream(std::size_t n, std::uint64_t seed,
                                                             Outputs outputs = Outputs::image) {
    std::mt19937_64 random(seed);
    std::normal_distribution<float> normal;
    const auto draw = [&](float scale, bool is_enabled) {
        return is_enabled ? scale * normal(random) : 0.0f;
    };
    const bool image = outputs == Outputs::image || outputs == Outputs::all;
    std::vector<reference::PixelGradient> gradients(n);
    for (reference::PixelGradient& g : gradients) {
        g.depth = draw(0.3f, image);
        for (double* x : {&g.weight, &g.intensity, &g.hit_logit, &g.drop_logit}) *x = draw(1.0f, image);
        for (int k = 0; k < 3; ++k)
            g.normal[k] = draw(1.0f, outputs == Outputs::normal || outputs == Outputs::all);
        g.distortion = draw(1.0f, outputs == Outputs::distortion || outputs == Outputs::all);
    }
    for (reference::PixelGradient& g : gradients)
        g.likelihood = draw(1.0f, outputs == Outputs::likelihood || outputs == Outputs::all);
    return gradients;
}

}  // namespace relidar::test
