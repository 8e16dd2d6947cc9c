// SPDX-License-Identifier: Apache-2.0
// Compares value and derivative of diff/loss/likelihood_loss with the double reference.
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>

#include "../../reference/loss.hpp"
#include "../../support/device.hpp"

namespace relidar {
namespace {

class LikelihoodTerm : public test::DeviceTest {};

TEST_F(LikelihoodTerm, AgreesWithReference) {
    constexpr std::size_t kRays = 279, kStride = 3;
    std::mt19937_64 random(9031);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::vector<reference::Pixel> pixels(kRays);
    std::vector<reference::Target> expected_targets(kRays);
    std::vector<shared::RenderedRay> rays(kRays);
    std::vector<DeviceTarget> measured(kRays * kStride);
    double n_returned = 0.0;
    for (std::size_t i = 0; i < kRays; ++i) {
        pixels[i].likelihood = float(unit(random) < 0.1 ? 0.0 : unit(random));
        rays[i].likelihood = float(pixels[i].likelihood);
        const bool returned = unit(random) < 0.95;
        expected_targets[i] = {returned ? 5.0 : 0.0, 0.5};
        // a ray without a return is either dropped or unknown
        DeviceTarget& target = measured[i * kStride];
        target = i % 2 ? DeviceTarget{0.0f, 0.5f, 1.0f} : DeviceTarget{5.0f, 0.5f, 0.0f};
        if (returned) target = {5.0f, 0.5f, 1.0f};
        n_returned += returned;
    }
    std::vector<reference::PixelGradient> expected;
    const double term = reference::compute_likelihood_loss(pixels, expected_targets, 0.02, &expected);
    const Array<shared::RenderedRay> rendered(device(), rays, "rendered");
    const Array<float> terms(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
    const Array<DeviceTarget> targets(device(), measured, "targets");
    std::vector<shared::RayGradient> others(kRays);
    for (shared::RayGradient& g : others) g.depth = 3.0f;
    Array<shared::RayGradient> upstream(device(), others, "upstream");
    const LossWeights weights{.likelihood = 0.7f, .likelihood_floor = 0.02f};
    LikelihoodLoss loss(device(), weights);
    Stream stream(device());
    loss.add_ray_losses(stream, {{}, &rendered, &upstream},
                        {&targets, 0, kStride, std::uint32_t(kRays), n_returned, double(kRays)}, terms);
    stream.submit_and_wait();
    const std::vector<float> actual_terms = terms.download();
    for (std::size_t k = 0; k < kLossTerms; ++k)
        EXPECT_NEAR(actual_terms[k], k == loss_term::likelihood ? 0.7 * term : 0.0, 1e-5 * term);
    const std::vector<shared::RayGradient> gradients = upstream.download();
    for (std::size_t i = 0; i < kRays; ++i) {
        const double d = 0.7 * expected[i].likelihood;
        EXPECT_NEAR(gradients[i].likelihood, d, 1e-5 * std::abs(d)) << "ray " << i;
        EXPECT_EQ(gradients[i].depth, 3.0f) << "gradients of other losses stay";
        EXPECT_EQ(gradients[i].weight, 0.0f);
    }
}

}  // namespace
}  // namespace relidar
