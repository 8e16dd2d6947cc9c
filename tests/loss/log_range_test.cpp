// SPDX-License-Identifier: Apache-2.0
// loss/log_range against the double reference, value and derivative, on D and D / W; dropped and unknown rays, strided targets.
#include <cmath>
#include <random>

#include <relidar/stages/loss.hpp>
#include <relidar/stages/traversal.hpp>

#include "../reference/loss.hpp"
#include "../support/device.hpp"
#include "../support/floats.hpp"
#include "../support/tolerances.hpp"

namespace relidar {
namespace {

class LogRange : public test::DeviceTest {};

TEST_F(LogRange, AgreesWithReference) {
    constexpr std::size_t kRays = 1037, kStride = 3;
    constexpr float kBefore = 0.25f;   // upstream of the losses before
    std::mt19937_64 random(3);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    for (const bool normalised : {false, true}) {
        std::vector<shared::RenderedRay> rendered;
        std::vector<DeviceTarget> targets(kRays * kStride);
        std::vector<reference::Pixel> pixels(kRays);
        std::vector<reference::Target> expected_targets(kRays);
        double n_returned = 0.0;
        for (std::size_t i = 0; i < kRays; ++i) {
            const float weight = 0.2f + 0.8f * unit(random), range = std::exp(5.0f * unit(random)) - 0.9f,
                        depth = weight * range * (0.5f + unit(random));
            const bool known = i % 5 != 0, returned = i % 7 != 0;
            shared::RenderedRay ray{};
            ray.depth = depth, ray.weight = weight;
            rendered.push_back(ray);
            targets[i * kStride] = {returned ? range : 0.0f, 0.5f, known ? 1.0f : 0.0f};
            pixels[i].depth = depth, pixels[i].weight = weight;
            expected_targets[i].range_m = known && returned ? range : 0.0f;
            n_returned += known && returned;
        }
        std::vector<reference::PixelGradient> expected;
        const double term = reference::log_range_loss(
            pixels, expected_targets, normalised ? reference::DepthKind::normalised : reference::DepthKind::blended, &expected);

        LossWeights weights;
        weights.log_range = 0.7f, weights.normalised_depth = normalised;
        LogRangeLoss loss(device(), weights);
        Stream stream(device());
        const Array<shared::RenderedRay> r(device(), std::span<const shared::RenderedRay>(rendered), "rendered");
        const Array<float> terms(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
        const Array<DeviceTarget> t(device(), std::span<const DeviceTarget>(targets), "targets");
        Array<shared::RayGradient> upstream(
            device(), std::vector<shared::RayGradient>(kRays, {kBefore, kBefore, kBefore, kBefore, kBefore}), "upstream");
        loss.compare(stream, {{}, &r, &upstream}, {&t, 0, kStride, kRays, n_returned, double(kRays)}, terms);
        stream.finish();
        EXPECT_NEAR(terms.download()[loss_term::log_range], 0.7 * term, 1e-5 * term);
        const std::vector<float> g = test::floats_of(upstream.download());
        for (std::size_t i = 0; i < kRays; ++i) {
            const double row[] = {0.7 * expected[i].depth, 0.7 * expected[i].weight, 0.0, 0.0, 0.0};
            for (std::size_t k = 0; k < 5; ++k)
                EXPECT_NEAR(g[5 * i + k] - kBefore, row[k], 1e-4 * std::abs(row[k]) + 1e-7) << "ray " << i << " lane " << k;
        }
    }
}

}  // namespace
}  // namespace relidar
