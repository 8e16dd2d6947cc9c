// SPDX-License-Identifier: Apache-2.0
// loss/relative_range against its closed form in double, value and central differences, on D and D / W; dropped and unknown rays, strided
// targets.
#include <cmath>
#include <random>

#include <relidar/stages/loss.hpp>
#include <relidar/stages/traversal.hpp>

#include "../support/device.hpp"
#include "../support/floats.hpp"
#include "../support/tolerances.hpp"

namespace relidar {
namespace {

class RelativeRange : public test::DeviceTest {};

double term_of(double depth, double weight, double range_m, bool normalised) {
    return std::abs(std::log1p(normalised ? depth / weight : depth) - std::log1p(range_m));
}

TEST_F(RelativeRange, AgreesWithItsClosedForm) {
    constexpr std::size_t kRays = 1037, kStride = 3;
    constexpr float kBefore = 0.25f;   // upstream of the losses before
    std::mt19937_64 random(3);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    for (const bool normalised : {false, true}) {
        std::vector<shared::RenderedRay> rendered(kRays);
        std::vector<DeviceTarget> targets(kRays * kStride);
        double n_returned = 0.0, sum = 0.0;
        for (std::size_t i = 0; i < kRays; ++i) {
            shared::RenderedRay& ray = rendered[i];
            ray.weight = 0.2f + 0.8f * unit(random);
            const float range_m = std::exp(5.0f * unit(random)) - 0.9f;
            ray.depth = ray.weight * range_m * (0.5f + unit(random));
            const bool known = i % 5 != 0, returned = i % 7 != 0;
            targets[i * kStride] = {returned ? range_m : 0.0f, 0.5f, known ? 1.0f : 0.0f};
            if (!known || !returned) continue;
            ++n_returned, sum += term_of(ray.depth, ray.weight, range_m, normalised);
        }
        LossWeights weights;
        weights.relative_range = 0.7f, weights.chamfer = 0.0f, weights.normalised_depth = normalised;
        const std::vector<std::unique_ptr<Loss>> losses = make_losses(device(), weights, kRays);
        ASSERT_EQ(losses.size(), 2u);
        Stream stream(device());
        const Array<shared::RenderedRay> r(device(), std::span<const shared::RenderedRay>(rendered), "rendered");
        const Array<float> terms(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
        const Array<DeviceTarget> t(device(), std::span<const DeviceTarget>(targets), "targets");
        const std::vector<shared::RayGradient> before(kRays, {kBefore, kBefore, kBefore, kBefore, kBefore});
        Array<shared::RayGradient> upstream(device(), before, "upstream");
        losses[1]->compare(stream, {{}, &r, &upstream}, {&t, 0, kStride, kRays, n_returned, double(kRays)}, terms);
        stream.finish();
        EXPECT_NEAR(terms.download()[loss_term::relative_range], 0.7 * sum / n_returned, 1e-5 * sum / n_returned);
        const std::vector<float> g = test::floats_of(upstream.download());
        for (std::size_t i = 0; i < kRays; ++i) {
            const DeviceTarget& target = targets[i * kStride];
            const bool counts = target.weight > 0.0f && target.range_m > 0.0f;
            const double d = rendered[i].depth, w = rendered[i].weight, h = 1e-6, scale = counts ? 0.7 / n_returned / (2.0 * h) : 0.0;
            const double d_depth = term_of(d + h, w, target.range_m, normalised) - term_of(d - h, w, target.range_m, normalised);
            const double d_weight = term_of(d, w + h, target.range_m, normalised) - term_of(d, w - h, target.range_m, normalised);
            const double row[] = {scale * d_depth, scale * d_weight, 0.0, 0.0, 0.0};
            for (std::size_t k = 0; k < 5; ++k)
                EXPECT_NEAR(g[5 * i + k] - kBefore, row[k], test::kKernelGradient * std::abs(row[k]) + 1e-7) << "ray " << i << ", " << k;
        }
    }
}

}  // namespace
}  // namespace relidar
