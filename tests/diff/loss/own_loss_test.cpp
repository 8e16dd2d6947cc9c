// SPDX-License-Identifier: Apache-2.0
// The loss of tools/examples: its values and gradients equal a closed form in double, and
// train() uses it like the losses of the settings.
#include <cmath>
#include <random>

#include <relidar/read/dataset.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

#include "../../../tools/examples/robust_loss.hpp"
#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "support/same_surfels.hpp"

namespace relidar {
namespace {

constexpr double kWeight = 0.7, kScaleM = 0.3;

class OwnLoss : public test::DeviceTest {
protected:
    RobustLoss make_loss() { return RobustLoss(device(), ROBUST_LOSS_SPIRV, float(kWeight), float(kScaleM)); }
};

/// The loss of a ray before the division by the number of returned rays.
double robust_loss(double depth, double weight, double range_m) {
    if (weight < 0.1) return 0.0;
    const double error = (depth / weight - range_m) / double(float(kScaleM));
    return double(float(kWeight)) * std::log1p(error * error);
}

TEST_F(OwnLoss, HasTheValuesAndDerivativesOfItsFormula) {
    constexpr std::size_t kRays = 300, kStride = 2, kFirst = 3;
    std::mt19937_64 random(71);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    std::vector<shared::RenderedRay> rays(kRays);
    std::vector<DeviceTarget> measured(kFirst + kRays * kStride);
    std::vector<bool> counts(kRays);
    double n_returned = 0.0;
    for (std::size_t i = 0; i < kRays; ++i) {
        rays[i].weight = i % 10 == 0 ? 0.05f : 0.2f + 0.8f * unit(random);
        const float range_m = 2.0f + 50.0f * unit(random);
        rays[i].depth = rays[i].weight * (range_m + 2.0f * unit(random) - 1.0f);
        // every third ray is dropped or unknown
        DeviceTarget& target = measured[kFirst + i * kStride];
        target = {range_m, 0.5f, 1.0f};
        if (i % 6 == 1) target.range_m = 0.0f;
        if (i % 6 == 4) target.weight = 0.0f;
        counts[i] = i % 3 != 1;
        n_returned += counts[i];
    }
    const Array<shared::RenderedRay> rendered(device(), rays, "rendered");
    const Array<DeviceTarget> targets(device(), measured, "targets");
    const Array<float> terms(device(), std::vector<float>(2 * kLossTerms, 1.0f), "terms");
    std::vector<shared::RayGradient> others(kRays);
    for (shared::RayGradient& g : others) g.depth = 3.0f, g.weight = -2.0f, g.intensity = 5.0f;
    Array<shared::RayGradient> upstream(device(), others, "upstream");
    RobustLoss loss = make_loss();
    Stream stream(device());
    loss.add_ray_losses(stream, {{}, &rendered, &upstream},
                        {&targets, kFirst, kStride, std::uint32_t(kRays), n_returned, double(kRays)},
                        {terms, 1});
    stream.submit_and_wait();
    double expected = 0.0;
    const std::vector<shared::RayGradient> gradients = upstream.download();
    for (std::size_t i = 0; i < kRays; ++i) {
        const double depth = rays[i].depth, weight = rays[i].weight,
                     range_m = measured[kFirst + i * kStride].range_m, h = 1e-6;
        const auto value = [&](double d, double w) { return robust_loss(d, w, range_m) / n_returned; };
        const double is_used = counts[i] ? 1.0 : 0.0;
        expected += is_used * value(depth, weight);
        const double d_depth = is_used * (value(depth + h, weight) - value(depth - h, weight)) / (2.0 * h),
                     d_weight = is_used * (value(depth, weight + h) - value(depth, weight - h)) / (2.0 * h);
        // Rounding of the range D / W, times the largest second derivative of the loss,
        // and rounding of the sum with the gradients of other losses.
        const double rounding = 2.0 * kWeight / (n_returned * kScaleM * kScaleM) * range_m * 0x1p-22;
        EXPECT_NEAR(gradients[i].depth, 3.0 + d_depth, 0x1p-22 + rounding / weight + 1e-5 * std::abs(d_depth))
            << "ray " << i;
        EXPECT_NEAR(gradients[i].weight, -2.0 + d_weight,
                    0x1p-22 + rounding * depth / (weight * weight) + 1e-5 * std::abs(d_weight))
            << "ray " << i;
        EXPECT_EQ(gradients[i].intensity, 5.0f);
    }
    const std::vector<float> sums = terms.download();
    for (std::size_t k = 0; k < sums.size(); ++k)
        EXPECT_NEAR(sums[k], k == kLossTerms + loss_term::custom ? 1.0 + expected : 1.0, 1e-5 * expected);
}

class OwnLossTraining : public OwnLoss {
protected:
    Log street = make_street_log({.n_frames = 6, .rows = 16, .columns = 256});
    Split split = split_frames(street, 0);
    Config config = make_preset("quick");
    const ScratchFolder scratch;

    void SetUp() override {
        OwnLoss::SetUp();
        config.init.voxel_m = 0.4;
        config.loss = {.depth = 0.0f, .intensity = 0.0f, .drop = 0.0f, .chamfer = 0.0f};
        config.train.iterations = 120;
        config.train.rays_per_iteration = 1000;
        config.train.log_every = 12;
        config.train.deterministic = true;
    }
    TrainResult train_robust(int n_iterations = 1 << 30, const Checkpoint* start = nullptr) {
        RobustLoss loss = make_loss();
        int step = 0;
        return train(device(), street, split, config, {},
                     {.checkpoints = scratch.path,
                      .start = start,
                      .stop = [&] { return ++step >= n_iterations; },
                      .losses = {&loss}});
    }
};

TEST_F(OwnLossTraining, ReducesTheLossAndResumes) {
    const TrainResult result = train_robust();
    const TrainProgress &first = result.log.front(), &last = result.log.back();
    EXPECT_LT(last.terms[loss_term::custom], 0.7 * first.terms[loss_term::custom]);
    EXPECT_EQ(last.loss, last.terms[loss_term::custom]) << "the only loss";
    EXPECT_TRUE(train_robust(25).interrupted);
    const std::optional<Checkpoint> checkpoint = load_newest(scratch.path, {});
    ASSERT_TRUE(checkpoint);
    const TrainResult resumed = train_robust(1 << 30, &*checkpoint);
    test::expect_same_surfels(resumed.scene.surfels, result.scene.surfels);
    // Groups of 64 rays add their sums in any order, each with one rounding.
    EXPECT_NEAR(resumed.log.back().loss, last.loss, 0x1p-23 * std::ceil(1000 / 64.0) * last.loss);
}

}  // namespace
}  // namespace relidar
