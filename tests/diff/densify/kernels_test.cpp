// SPDX-License-Identifier: Apache-2.0
// Tests two kernels of densification separately: allot with small arrays, and
// reset_opacity.
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

}  // namespace
}  // namespace relidar
