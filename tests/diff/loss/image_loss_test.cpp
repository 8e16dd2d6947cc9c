// SPDX-License-Identifier: Apache-2.0
// Compares values and derivatives of diff/loss/image_loss (Eq. 10, M6) with the double
// reference, for both depth and both intensity terms, masked rays, extreme logits and
// strided batches.
#include <cmath>
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>

#include "../../reference/loss.hpp"
#include "../../support/device.hpp"
#include "../../support/floats.hpp"
#include "../../support/tolerances.hpp"

namespace relidar {
namespace {

class ImageLossTest : public test::DeviceTest {};

struct Data {
    std::vector<shared::RenderedRay> rendered;
    std::vector<DeviceTarget> targets;
    std::vector<reference::Pixel> pixels;
    std::vector<reference::Target> expected_targets;
};

Data make_random_data(std::size_t count, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    Data d;
    for (std::size_t i = 0; i < count; ++i) {
        const float weight = 0.2f + 0.8f * unit(random), range = 2.0f + 50.0f * unit(random),
                    depth = weight * (range + unit(random) - 0.5f);
        const float spread = i % 7 == 0 ? 80.0f : 3.0f;  // includes extreme logits
        const float hit = spread * (unit(random) - 0.5f), drop = spread * (unit(random) - 0.5f),
                    intensity = unit(random);
        const bool dropped = unit(random) < 0.3f;
        shared::RenderedRay& ray = d.rendered.emplace_back();
        ray.depth = depth;
        ray.weight = weight;
        ray.intensity = intensity;
        ray.hit_logit = hit;
        ray.drop_logit = drop;
        d.targets.push_back({dropped ? 0.0f : range, dropped ? 0.0f : unit(random), 1.0f});
        reference::Pixel p;
        p.depth = depth;
        p.weight = weight;
        p.intensity = intensity;
        p.hit_logit = hit;
        p.drop_logit = drop;
        d.pixels.push_back(p);
        d.expected_targets.push_back({d.targets.back().range_m, d.targets.back().intensity});
    }
    return d;
}

TEST_F(ImageLossTest, AgreesWithReference) {
    for (const std::size_t n : {std::size_t(1), std::size_t(1000), std::size_t(1037)})
        for (const bool normalised : {false, true}) {
            const Data d = make_random_data(n, n);
            const LossWeights weights{.normalised_depth = normalised,
                                      .intensity_delta = normalised ? 0.2f : 0.0f};
            constexpr std::size_t kFloats = sizeof(shared::RayGradient) / sizeof(float);
            std::vector<reference::PixelGradient> expected;
            const reference::LossTerms terms = reference::evaluate_loss(
                d.pixels, d.expected_targets,
                {weights.depth, weights.intensity, weights.drop, weights.intensity_delta},
                normalised ? reference::DepthKind::normalised : reference::DepthKind::blended, &expected);
            ImageLoss loss(device(), weights);
            Stream stream(device());
            const Array<shared::RenderedRay> rendered(device(), d.rendered, "rendered");
            const Array<DeviceTarget> targets(device(), d.targets, "targets");
            Array<shared::RayGradient> upstream(device(), n + 1, "upstream");
            const Array<float> sums(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
            stream.fill(upstream, 0x7fc00000u);
            double returned = 0.0;
            for (const DeviceTarget& t : d.targets) returned += t.range_m > 0.0f;
            loss.add_ray_losses(stream, {{}, &rendered, &upstream},
                                {&targets, 0, 1, std::uint32_t(n), returned, double(n)}, sums);
            stream.submit_and_wait();
            const std::vector<float> g = test::to_floats(upstream.download()), s = sums.download();
            EXPECT_NEAR(s[loss_term::depth], weights.depth * terms.depth, 1e-4 * weights.depth * terms.depth);
            EXPECT_NEAR(s[loss_term::intensity], weights.intensity * terms.intensity,
                        1e-4 * weights.intensity * terms.intensity);
            EXPECT_NEAR(s[loss_term::drop], weights.drop * terms.drop, 1e-4 * weights.drop * terms.drop);
            for (std::size_t i = 0; i < n; ++i) {
                const double row[] = {expected[i].depth,     expected[i].weight,     expected[i].intensity,
                                      expected[i].hit_logit, expected[i].drop_logit, 0.0};
                for (std::size_t k = 0; k < kFloats; ++k)
                    EXPECT_NEAR(g[kFloats * i + k], row[k], 1e-6 * (std::abs(row[k]) + 1.0 / double(n)))
                        << "ray " << i << " lane " << k;
            }
            for (std::size_t k = 0; k < kFloats; ++k)
                EXPECT_TRUE(std::isnan(g[kFloats * n + k])) << "wrote past the end";
        }
}

TEST_F(ImageLossTest, MaskedRaysAreIgnoredAndStrideSelects) {
    Data d = make_random_data(64, 9);
    for (std::size_t i = 0; i < 64; ++i) d.targets[i].weight = i % 4 == 1 ? 1.0f : 0.0f;
    ImageLoss loss(device(), {});
    Stream stream(device());
    const Array<DeviceTarget> targets(device(), d.targets, "targets");
    const Array<shared::RenderedRay> rendered(device(), d.rendered, "rendered");
    const Array<float> sums(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
    Array<shared::RayGradient> upstream(device(), 16, "upstream");
    // targets 0, 4, 8, ... are masked
    loss.add_ray_losses(stream, {{}, &rendered, &upstream}, {&targets, 0, 4, 16, 16.0, 16.0}, sums);
    stream.submit_and_wait();
    for (const float x : test::to_floats(upstream.download())) EXPECT_EQ(x, 0.0f);
    for (const float x : sums.download()) EXPECT_EQ(x, 0.0f);
    // targets 1, 5, 9, ... have a measured value
    loss.add_ray_losses(stream, {{}, &rendered, &upstream}, {&targets, 1, 4, 16, 16.0, 16.0}, sums);
    stream.submit_and_wait();
    EXPECT_GT(sums.download()[loss_term::drop], 0.0f);
}

const char* get_loss_type_name(const Loss& loss) {
    if (dynamic_cast<const ImageLoss*>(&loss)) return "image";
    if (dynamic_cast<const LikelihoodLoss*>(&loss)) return "likelihood";
    if (dynamic_cast<const ChamferLoss*>(&loss)) return "chamfer";
    if (dynamic_cast<const ActorBoxLoss*>(&loss)) return "surfel";
    return "another";
}

std::vector<std::string> list_made_kernels(Device& device, const LossWeights& weights) {
    std::vector<std::string> names;
    for (const std::unique_ptr<Loss>& loss : make_losses(device, weights, 64))
        names.push_back(get_loss_type_name(*loss));
    return names;
}

TEST_F(ImageLossTest, ComesFirstAndEachOtherLossOnceWhereATermAsksForIt) {
    using Names = std::vector<std::string>;
    const auto of = [&](LossWeights weights, float chamfer) {
        weights.chamfer = chamfer;
        return list_made_kernels(device(), weights);
    };
    EXPECT_EQ(of({.depth = 0.0f, .intensity = 0.0f, .drop = 0.0f}, 0.0f), Names{"image"})
        << "it outputs what others add to";
    EXPECT_EQ(of({}, 0.1f), (Names{"image", "chamfer"}));
    EXPECT_EQ(of({.likelihood = 0.1f}, 0.0f), (Names{"image", "likelihood"}));
    EXPECT_EQ(of({.opacity = 0.1f, .box = 0.1f, .likelihood = 0.1f}, 0.1f),
              (Names{"image", "surfel", "chamfer", "likelihood"}));
}

}  // namespace
}  // namespace relidar
