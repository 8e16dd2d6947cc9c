// SPDX-License-Identifier: Apache-2.0
// Compares diff/loss/surfel_loss, the penalty for surfels outside their box, with the
// double reference.
#include <random>

#include <relidar/diff/loss.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../reference/surfel_loss.hpp"
#include "../../support/device.hpp"
#include "../../support/gradient_check.hpp"

namespace relidar {
namespace {

class SurfelLossTest : public test::DeviceTest {};

constexpr std::uint32_t kBackground = 70, kActor = 45;

Scene random_scene() {
    std::mt19937_64 random(8);
    std::uniform_real_distribution<float> uniform(-3.0f, 3.0f);
    Scene scene;
    scene.surfels.resize(kBackground + 2 * kActor);
    for (glm::vec3& m : scene.surfels.mean) m = {uniform(random), uniform(random), uniform(random)};
    for (glm::vec4& q : scene.surfels.rotation) q = {1, 0, 0, 0};
    for (glm::vec2& s : scene.surfels.log_scale)
        s = 0.4f * glm::vec2(uniform(random), uniform(random) - 2.0f);
    for (float& o : scene.surfels.opacity_logit) o = 4.0f * uniform(random);
    scene.surfels.opacity_logit[3] = 500.0f;
    scene.surfels.opacity_logit[4] = -500.0f;
    scene.models = {{"background", 0, kBackground},
                    {"a", kBackground, kActor, {2.0f, 0.9f, 0.75f}},
                    {"b", kBackground + kActor, kActor, {1.0f, 0.3f, 0.85f}}};
    scene.instances = {{0, ""}, {2, "b"}, {1, "a"}};
    return scene;
}

TEST_F(SurfelLossTest, AgreesWithReference) {
    Scene scene = random_scene();
    const LossWeights weights{.box = 0.3f};
    const std::size_t n = scene.surfels.size();
    for (const bool all : {true, false}) {
        if (!all) convert_surfels(scene.surfels, PrimitiveType::gaussian, 3.0);
        const bool is_gaussian = !all;
        std::vector<std::uint32_t> touched(n);
        for (std::size_t i = 0; i < n; ++i) touched[i] = i % 3 != 0;
        Stream stream(device());
        DeviceScene on_device(device(), scene);
        SurfelArrays d(device(), std::uint32_t(n), "gradient", scene.surfels.primitive);
        d.fill_zero(stream);
        stream.fill(d.mean, 0x3e800000u);  // 0.25
        const Array<std::uint32_t, shared::TouchedSurfels> rows(device(), touched, "touched");
        const Array<float> terms(device(), std::vector<float>(kLossTerms, 0.0f), "terms");
        ActorBoxLoss loss(device(), weights);
        loss.add_regularisers(stream, on_device, {&d, all ? nullptr : &rows}, terms);
        stream.submit_and_wait();

        double box = 0.0;
        test::GradientTable table;
        const Surfels device_result = d.download();
        for (std::size_t i = 0; i < n; ++i) {
            reference::BoxedSurfel expected, ignored;
            expected.mean = {0.25, 0.25, 0.25};
            const bool write = all || touched[i];
            if (i >= kBackground) {
                const glm::dvec3 h = scene.models[i < kBackground + kActor ? 1 : 2].half_size_m;
                const Surfels& s = scene.surfels;
                reference::BoxedSurfel surfel{{s.mean[i].x, s.mean[i].y, s.mean[i].z},
                                              {s.log_scale[i].x, s.log_scale[i].y}};
                if (is_gaussian) surfel.log_scale_w = s.log_scale_w[i];
                box += reference::compute_box_loss(surfel, {{h.x, h.y, h.z}, 0.2 * glm::length(h)},
                                                   0.3 / (2 * kActor), write ? expected : ignored);
            }
            table.add_row("mean", {expected.mean[0], expected.mean[1], expected.mean[2]},
                          {device_result.mean[i].x, device_result.mean[i].y, device_result.mean[i].z});
            table.add_row("log_scale", {expected.log_scale[0], expected.log_scale[1]},
                          {device_result.log_scale[i].x, device_result.log_scale[i].y});
            if (is_gaussian)
                table.add_row("log_scale_w", {expected.log_scale_w.value_or(0.0)},
                              {device_result.log_scale_w[i]});
        }
        EXPECT_NEAR(terms.download()[loss_term::box], 0.3 * box / (2 * kActor), 1e-5 * box);
        EXPECT_LE(table.compute_worst_error(), test::kKernelGradient);
        for (const auto& [name, group] : table.groups()) EXPECT_EQ(group.count_missing_rows(), 0u) << name;
    }
}

}  // namespace
}  // namespace relidar
