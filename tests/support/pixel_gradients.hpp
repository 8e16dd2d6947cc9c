// SPDX-License-Identifier: Apache-2.0
// Makes random gradients of rendered values.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "../reference/render.hpp"

namespace relidar::test {

/// Which outputs of a ray have a gradient.
enum class Outputs { image, likelihood, all };

/// Returns random gradients that are rounded to float, so that a kernel can receive
/// exactly the same gradients.
inline std::vector<reference::PixelGradient> make_random_upstream(std::size_t count, std::uint64_t seed,
                                                                  Outputs outputs = Outputs::image) {
    std::mt19937_64 random(seed);
    std::normal_distribution<float> normal;
    std::vector<reference::PixelGradient> gradients(count);
#define RELIDAR_DRAW(name, built, value, input, slope, meaning) g.name = normal(random);
    if (outputs != Outputs::likelihood)
        for (reference::PixelGradient& g : gradients) {
            RELIDAR_IMAGE_VALUES(RELIDAR_DRAW)
            g.depth = 0.3f * float(g.depth);  // metres
        }
    if (outputs != Outputs::image)
        for (reference::PixelGradient& g : gradients) {
            RELIDAR_LOSS_VALUES(RELIDAR_DRAW)
        }
#undef RELIDAR_DRAW
    return gradients;
}

}  // namespace relidar::test
