// SPDX-License-Identifier: Apache-2.0
// Makes random scenes with random gradients of their rendered values.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "random_scene.hpp"

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

/// Random scene, and random derivatives of a loss with respect to its image.
struct GradientProblem {
    reference::Settings settings;
    RandomScene scene;
    std::vector<reference::PixelGradient> upstream;

    GradientProblem(const ImageModel& image, const RandomSceneOptions& options,
                    Outputs outputs = Outputs::image) {
        settings.image = image;
        settings.image.primitive = options.primitive;
        settings.likelihood_scale_m = 0.3;
        scene = make_random_scene(options, settings);
        settings.view_origin = scene.view_origin;
        upstream = make_random_upstream(scene.rays.size(), options.seed, outputs);
    }
    /// Returns the loss of each ray.
    std::vector<double> terms() const {
        std::vector<double> result;
        for (const reference::Pixel& pixel : reference::render(scene.world, settings, scene.rays))
            result.push_back(compute_inner_product(upstream[result.size()], pixel));
        return result;
    }
    reference::Gradients gradients() const {
        return reference::backward(scene.world, settings, scene.rays, upstream);
    }
};

}  // namespace relidar::test
