// SPDX-License-Identifier: Apache-2.0
// Tests three kernels of densification separately: allot with small arrays,
// reset_opacity, and the sums and counts of observe, with batches that contain only a
// part of a frame's rays.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../reference/densify.hpp"
#include "../../support/device.hpp"
#include "base/random.hpp"
#include "diff/densify/growth_plan.hpp"
#include "diff/shared/densify.h"
#include "gpu/stream.hpp"
#include "random_model.hpp"

namespace relidar {
namespace {

class DensifyKernels : public test::DeviceTest {};

/// Compares the number of copies that the kernel allots to each surfel with the
/// reference.
/// @param largest largest weight
void expect_allotted(Device& device, std::uint32_t largest) {
    std::mt19937 random(4);
    const std::uint32_t n = 777;
    std::vector<std::uint32_t> weight(n), cumulative(n), action(n);
    for (std::uint32_t i = 0; i < n; ++i) {
        action[i] = random() % 4 == 0 ? RELIDAR_DENSIFY_DROP : RELIDAR_DENSIFY_CLONE;
        weight[i] = action[i] == RELIDAR_DENSIFY_DROP ? 0 : 1 + random() % largest;
    }
    std::exclusive_scan(weight.begin(), weight.end(), cumulative.begin(), 0u);
    const std::uint32_t total = cumulative.back() + weight.back();
    const Kernel<shared::AllotParams> allot(device, "diff/densify/allot");
    for (const std::uint32_t n_new : {0u, 1u, 300u, 5000u}) {
        GrowthPlan plan{0, total, n_new, std::uint32_t(random() % total)};
        const Array<std::uint32_t, shared::GrowthWeights> w(device, weight, "weight");
        const Array<std::uint32_t, shared::WeightsBefore> c(device, cumulative, "cumulative");
        const Array<std::uint32_t, shared::DensifyActions> a(device, action, "action");
        const Array<std::uint32_t, shared::RowCounts> rows(device, n, "rows");
        Stream stream(device);
        run(stream, allot, n,
            {.weight = w.address(),
             .cumulative = c.address(),
             .action = a.address(),
             .n_rows = rows.address(),
             .n_surfels = n,
             .n_new = n_new,
             .total_weight = total,
             .phase = plan.phase});
        stream.submit_and_wait();
        const std::vector<std::uint32_t> copies = reference::count_copies(weight, n_new, plan.phase),
                                         actual = rows.download(), fate = a.download();
        for (std::uint32_t i = 0; i < n; ++i) {
            EXPECT_EQ(actual[i], action[i] == RELIDAR_DENSIFY_DROP ? 0 : 1 + copies[i]);
            EXPECT_EQ(fate[i], action[i] == RELIDAR_DENSIFY_CLONE && copies[i] == 0 ? RELIDAR_DENSIFY_KEEP
                                                                                    : action[i]);
            EXPECT_EQ(
                plan.cumulative_copies(cumulative[i] + weight[i]) - plan.cumulative_copies(cumulative[i]),
                copies[i])
                << "what the host expects";
        }
    }
}

TEST_F(DensifyKernels, AllotHandsOutAsTheReferenceDoes) {
    expect_allotted(device(), 255);
    // the sum of the weights is close to 2^32, so its product with n_new needs 64 bits
    expect_allotted(device(), 10'000'000);
}

struct Trained {
    Scene scene;
    DeviceScene device_scene;
    Adam adam;
    Densifier densifier;
    Trained(Device& device, float alpha_min)
        : scene(test::make_random_model_scene({200}, 3)),
          device_scene(device, scene),
          adam(device, std::uint32_t(scene.surfels.size()), {}, scene.surfels.primitive),
          densifier(device, scene, {.strategy = DensifyStrategy::adaptive}, alpha_min, 3, 9) {}
};

TEST_F(DensifyKernels, ResetOpacityAtItsTimes) {
    Trained t(device(), 1.0f / 255.0f);
    const Surfels tags = t.scene.surfels;
    Stream stream(device());
    for (const int step : {2999, 3001, 15000})
        t.densifier.reset_opacities(stream, t.device_scene, t.adam, step);
    stream.submit_and_wait();
    EXPECT_EQ(t.device_scene.surfel_parameters().download().opacity_logit, tags.opacity_logit)
        << "nothing is due at these steps";
    t.adam.first_moments().upload(tags);
    t.adam.second_moments().upload(tags);
    t.densifier.reset_opacities(stream, t.device_scene, t.adam, 3000);
    stream.submit_and_wait();
    const Surfels after = t.device_scene.surfel_parameters().download(),
                  m = t.adam.first_moments().download(), v = t.adam.second_moments().download();
    const float limit = std::log(0.01f / 0.99f);
    std::size_t lowered = 0;
    for (std::size_t i = 0; i < after.size(); ++i) {
        EXPECT_FLOAT_EQ(after.opacity_logit[i], std::min(tags.opacity_logit[i], limit));
        lowered += tags.opacity_logit[i] > limit;
    }
    EXPECT_GT(lowered, 100u);
    EXPECT_EQ(m.opacity_logit, std::vector<float>(after.size(), 0.0f));
    EXPECT_EQ(v.opacity_logit, std::vector<float>(after.size(), 0.0f));
    EXPECT_EQ(m.sh, tags.sh) << "the other groups keep their moments";
    EXPECT_EQ(after.log_scale, tags.log_scale);
}

/// Opacities must not be reset below the visibility limit, because an invisible surfel
/// would never get a gradient again.
TEST_F(DensifyKernels, WhatIsResetStaysVisible) {
    constexpr float kAlphaMin = 0.04f;
    Trained t(device(), kAlphaMin);
    const std::vector<float> before = t.scene.surfels.opacity_logit;
    Stream stream(device());
    t.densifier.reset_opacities(stream, t.device_scene, t.adam, 3000);
    stream.submit_and_wait();
    const std::vector<float> after = t.device_scene.surfel_parameters().download().opacity_logit;
    const float limit = std::log(0.1f / 0.9f);  // opacity 2.5 * 0.04
    for (std::size_t i = 0; i < after.size(); ++i) EXPECT_NEAR(after[i], std::min(before[i], limit), 1e-6);
}

class Statistics : public test::DeviceTest {};

struct Observed {
    Device& device;
    DeviceScene scene;
    Densifier densifier;
    SurfelArrays gradients;
    Array<std::uint32_t, shared::TouchedSurfels> touched;
    Stream stream;
    std::uint32_t n;

    Observed(Device& d, std::uint32_t n_surfels, std::uint32_t n_frames)
        : Observed(d, test::make_random_model_scene({n_surfels}, 1), n_frames) {}
    Observed(Device& d, const Scene& initial, std::uint32_t n_frames)
        : device(d),
          scene(d, initial),
          densifier(d, initial, {.strategy = DensifyStrategy::adaptive}, 0.0f, n_frames, 1),
          gradients(d, scene.size(), "gradients"),
          touched(d, scene.size(), "touched"),
          stream(d),
          n(scene.size()) {}

    void show(const std::vector<float>& d_mean, const std::vector<std::uint32_t>& is_touched,
              std::uint32_t frame, bool is_full_frame) {
        gradients.mean.upload(d_mean);
        touched.upload(is_touched);
        densifier.record_statistics(stream, scene, {&gradients, &touched, frame, is_full_frame});
        stream.submit_and_wait();
    }
};

TEST_F(Statistics, SumsAndCountsOverBatches) {
    constexpr std::uint32_t kN = 333, kFrames = 70;  // three words of frame bits
    Observed o(device(), kN, kFrames);
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<double> sum(kN, 0.0);
    std::vector<std::uint32_t> n_observing_batches(kN, 0);
    std::vector<std::vector<bool>> frames(kN, std::vector<bool>(kFrames, false));
    for (int batch = 0; batch < 24; ++batch) {
        const std::uint32_t frame = random() % kFrames;
        const bool full = batch % 2 == 0;
        std::vector<float> d_mean(3 * kN);
        std::vector<std::uint32_t> touched(kN);
        for (std::uint32_t i = 0; i < kN; ++i) {
            touched[i] = random() % 3 == 0;
            // undefined for surfels that are not touched
            for (std::uint32_t k = 0; k < 3; ++k) d_mean[3 * i + k] = touched[i] ? normal(random) : NAN;
            if (touched[i] || (!full && frames[i][frame])) ++n_observing_batches[i];
            if (!touched[i]) continue;
            sum[i] += std::sqrt(double(d_mean[3 * i]) * d_mean[3 * i] +
                                double(d_mean[3 * i + 1]) * d_mean[3 * i + 1] +
                                double(d_mean[3 * i + 2]) * d_mean[3 * i + 2]);
            frames[i][frame] = true;
        }
        o.show(d_mean, touched, frame, full);
    }
    const SurfelStatistics& s = o.densifier.statistics();
    ASSERT_EQ(s.n_words, 3u);
    const std::vector<float> sums = s.gradient_sum.download();
    const std::vector<std::uint32_t> counts = s.n_observing_batches.download(), bits = s.frames.download();
    for (std::uint32_t i = 0; i < kN; ++i) {
        EXPECT_NEAR(sums[i], sum[i], 1e-5 * (1.0 + sum[i]));
        EXPECT_EQ(counts[i], n_observing_batches[i]);
        for (std::uint32_t f = 0; f < kFrames; ++f)
            EXPECT_EQ((bits[3 * i + f / 32] >> (f % 32)) & 1u, frames[i][f] ? 1u : 0u);
    }
}

/// Surfel i covers i + 1 rays in each of three frames, all with the same gradient. The
/// loss is a mean over the batch. Batches with every s-th ray must give the same
/// statistics as batches with all rays. This also applies to surfels that most batches
/// miss.
TEST_F(Statistics, EveryStridethRayCountsAsTheWholeFrame) {
    constexpr std::uint32_t kN = 40, kRays = 1000, kStride = 16;
    const auto mean_of = [&](std::uint32_t stride, int n_batches) {
        Observed o(device(), kN, 3);
        std::mt19937 random(8);
        for (int batch = 0; batch < n_batches; ++batch) {
            const std::uint32_t first = random() % stride;
            std::vector<float> d_mean(3 * kN, 0.0f);
            std::vector<std::uint32_t> touched(kN, 0);
            for (std::uint32_t i = 0; i < kN; ++i)
                for (std::uint32_t ray = 7 * i; ray <= 8 * i; ++ray) {
                    if (ray % stride != first) continue;
                    touched[i] = 1;
                    d_mean[3 * i + 1] += float(stride) / kRays;
                }
            o.show(d_mean, touched, std::uint32_t(batch) % 3, stride == 1);
        }
        const std::vector<float> sum = o.densifier.statistics().gradient_sum.download();
        const std::vector<std::uint32_t> n_observing_batches =
            o.densifier.statistics().n_observing_batches.download();
        std::vector<double> mean(kN);
        for (std::uint32_t i = 0; i < kN; ++i) mean[i] = sum[i] / std::max(n_observing_batches[i], 1u);
        return mean;
    };
    const std::vector<double> full = mean_of(1, 3), part = mean_of(kStride, 600);
    for (std::uint32_t i = 0; i < kN; ++i) {
        EXPECT_NEAR(full[i], double(i + 1) / kRays, 1e-6);
        // checks the normalisation: a mean over only the batches that hit a surfel would
        // be 16 times too large for a single ray
        EXPECT_NEAR(part[i] / full[i], 1.0, 0.35) << i + 1 << " rays";
    }
}

}  // namespace
}  // namespace relidar
