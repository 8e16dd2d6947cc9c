// SPDX-License-Identifier: Apache-2.0
// Compares diff/optimizer/adam with Adam in double for every parameter group. Also covers
// surfels without a gradient, inactive SH coefficients, and the learning-rate schedule.
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <relidar/diff/optimizer.hpp>
#include <relidar/scene/device_scene.hpp>
#include "gpu/forced.hpp"

#include "../../support/device.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

class AdamTest : public test::DeviceTest {};
class AdamThreads : public test::DeviceTest, public testing::WithParamInterface<bool> {};
INSTANTIATE_TEST_SUITE_P(PerRowAndPerFloat, AdamThreads, testing::Bool());

Surfels make_random_surfels(std::uint32_t count, std::uint64_t seed, SurfelParameterSet parameter_set) {
    std::mt19937_64 random(seed);
    std::normal_distribution<float> normal;
    Surfels s;
    s.resize(count, parameter_set);
    for (auto& x : s.mean) x = {normal(random), normal(random), normal(random)};
    for (auto& x : s.rotation) x = {normal(random), normal(random), normal(random), normal(random)};
    for (auto& x : s.log_scale) x = {normal(random), normal(random)};
    for (auto& x : s.opacity_logit) x = normal(random);
    for (auto& x : s.sh) x = normal(random);
    for (auto& x : s.log_scale_w) x = normal(random);
    for (GaitPhaseWindow& x : s.gait)
        x = {normal(random), normal(random), {normal(random), normal(random), normal(random)}};
    return s;
}

struct Scalar {
    double value, m = 0.0, v = 0.0, ceiling = std::numeric_limits<double>::infinity();
    void step(double g, double rate, int t) {
        m = 0.9 * m + 0.1 * g;
        v = 0.999 * v + 0.001 * g * g;
        value -= rate * (m / (1.0 - std::pow(0.9, t))) / (std::sqrt(v / (1.0 - std::pow(0.999, t))) + 1e-15);
        value = std::min(value, ceiling);
    }
};

/// The means and the logits of each model must learn at the rates of this model. All
/// other parameters share their rates. Uses three models, the second without surfels.
TEST_P(AdamThreads, MeansAndLogitsLearnAtTheRateOfTheirModel) {
    const std::uint32_t n = 90, n_fixed = 11;
    std::vector<shared::ModelEntry> entries(3);
    entries[1].first_surfel = entries[2].first_surfel = 40;
    const Array<shared::ModelEntry> models(device(), entries, "models");
    const LearningRates rates{.mean = 1e-2,
                              .rotation = 2e-3,
                              .log_scale = 3e-3,
                              .opacity_logit = 4e-2,
                              .models = &models,
                              .mean_factors = {1.0f, 7.0f, 0.25f}};
    const ForcedBehaviourScope forced(device(), {.coalesces = GetParam()});
    Adam adam(device(), n, {.n_fixed = n_fixed});
    adam.set_logit_factors({1.0f, 9.0f, 5.0f});
    Stream stream(device());
    SurfelArrays parameters(device(), n, "parameters"), gradients(device(), n, "gradients");
    const Surfels start = make_random_surfels(n, 1, PrimitiveType::surfel);
    parameters.upload(start);
    std::vector<Surfels> g;
    for (int t = 1; t <= 2; ++t) {
        g.push_back(make_random_surfels(n, 20 + std::uint64_t(t), PrimitiveType::surfel));
        gradients.upload(g.back());
        adam.record_step(stream, parameters, gradients, nullptr, rates, t, 2);
        stream.submit_and_wait();
    }
    const Surfels actual = parameters.download();
    for (std::uint32_t i = n_fixed; i < n; ++i) {
        Scalar mean{start.mean[i].y}, scale{start.log_scale[i].x};
        for (int t = 1; t <= 2; ++t) {
            mean.step(g[std::size_t(t - 1)].mean[i].y, 1e-2 * (i < 40 ? 1.0 : 0.25), t);
            scale.step(g[std::size_t(t - 1)].log_scale[i].x, 3e-3, t);
        }
        EXPECT_NEAR(actual.mean[i].y, mean.value, 1e-6) << i;
        EXPECT_NEAR(actual.log_scale[i].x, scale.value, 1e-6) << i;
        // Channels: intensity, hit logit, drop logit. Harmonic 3 has the lower rate.
        for (const std::size_t k : {0u, 3u, 16u, 35u}) {
            const std::size_t at = std::size_t(i) * kShFloats + k;
            Scalar sh{start.sh[at]};
            for (int t = 1; t <= 2; ++t)
                sh.step(
                    g[std::size_t(t - 1)].sh[at],
                    rates.sh * (k % 16 == 0 ? 1.0 : rates.sh_rest_factor) * (k < 16 || i < 40 ? 1.0 : 5.0),
                    t);
            EXPECT_NEAR(actual.sh[at], sh.value, 1e-6) << i << ' ' << k;
        }
    }
}

/// Uses a launch with more workgroups than one dimension of a dispatch can have. Each
/// parameter must get one step. The first step of Adam is the learning rate in the
/// direction of the gradient.
TEST_F(AdamTest, StepsEachParameterOnceInALargeLaunch) {
    const std::uint32_t n = 200'001;  // 75,001 workgroups of 128 threads, or 300,002 of 32
    Surfels start, gradient;
    start.resize(n);
    gradient.resize(n);
    std::ranges::fill(start.sh, 0.0f);
    std::ranges::fill(gradient.sh, 1.0f);
    const ForcedBehaviourScope forced(device(), {.coalesces = true});
    Adam adam(device(), n, {});
    Stream stream(device());
    SurfelArrays parameters(device(), n, "parameters"), gradients(device(), n, "gradients");
    parameters.upload(start);
    gradients.upload(gradient);
    adam.record_step(stream, parameters, gradients, nullptr, {.sh = 1e-2, .sh_rest_factor = 1.0}, 1, 3);
    stream.submit_and_wait();
    const Surfels actual = parameters.download();
    const auto n_wrong =
        std::ranges::count_if(actual.sh, [](float value) { return std::abs(value + 1e-2f) > 1e-6f; });
    EXPECT_EQ(n_wrong, 0);
}

const LearningRates kRates{.mean = 1e-3,
                           .rotation = 2e-3,
                           .log_scale = 3e-3,
                           .opacity_logit = 4e-2,
                           .sh = 5e-3,
                           .sh_rest_factor = 0.05,
                           .gait = 7e-4,
                           .intensity_factor = 0.4};

std::vector<float> make_some_bounds(std::uint32_t count) {
    std::vector<float> bounds(count);
    for (std::uint32_t i = 0; i < count; ++i) bounds[i] = 0.4f + 0.2f * float(i) / float(count);
    return bounds;
}

/// Calls expect(value before, value after, learning rate, gradient) for each parameter of
/// surfel `i`.
template <class Expect>
void for_each_parameter(const Surfels& start, const Surfels& actual, std::uint32_t i,
                        const SurfelParameterSet& set, Expect&& expect) {
    for (int k = 0; k < 3; ++k)
        expect(start.mean[i][k], actual.mean[i][k], kRates.mean,
               [&](const Surfels& surfels) { return surfels.mean[i][k]; });
    for (int k = 0; k < 4; ++k)
        expect(start.rotation[i][k], actual.rotation[i][k], kRates.rotation,
               [&](const Surfels& surfels) { return surfels.rotation[i][k]; });
    for (int k = 0; k < 2; ++k)
        expect(start.log_scale[i][k], actual.log_scale[i][k], kRates.log_scale,
               [&](const Surfels& surfels) { return surfels.log_scale[i][k]; });
    for (int k = 0; k < 5 && set.bends; ++k)
        expect((&start.gait[i].phase)[k], (&actual.gait[i].phase)[k], kRates.gait,
               [&](const Surfels& surfels) { return (&surfels.gait[i].phase)[k]; });
    if (properties_of(set.primitive).third_scale)
        expect(start.log_scale_w[i], actual.log_scale_w[i], kRates.log_scale,
               [&](const Surfels& surfels) { return surfels.log_scale_w[i]; });
    expect(start.opacity_logit[i], actual.opacity_logit[i], kRates.opacity_logit,
           [&](const Surfels& surfels) { return surfels.opacity_logit[i]; });
    for (std::size_t k = 0; k < kShFloats; ++k) {
        const std::size_t within = k % kShCoefficients, slot = i * kShFloats + k;
        // degree 2: nine coefficients
        const double factor = (within == 0 ? 1.0 : kRates.sh_rest_factor) *
                              (k < kShCoefficients ? kRates.intensity_factor : 1.0);
        const double rate = within >= 9 ? 0.0 : kRates.sh * factor;
        expect(start.sh[slot], actual.sh[slot], rate,
               [&](const Surfels& surfels) { return surfels.sh[slot]; });
    }
}

/// Tests one thread per row and one thread per float. In the first case all rows have a
/// gradient. In the second case, parameters of rows without a gradient decay. In the
/// third case, these rows stay unchanged. In the last two cases the first rows are fixed.
TEST_P(AdamThreads, AgreeWithAdamInDouble) {
    const std::uint32_t n = 133;
    const std::vector<float> bounds = make_some_bounds(n);
    enum class Untouched { none, decay, stay };
    for (const Untouched untouched : {Untouched::none, Untouched::decay, Untouched::stay}) {
        const bool only_touched = untouched == Untouched::stay;
        const SurfelParameterSet parameter_set{only_touched ? PrimitiveType::gaussian : PrimitiveType::surfel,
                                               untouched == Untouched::decay};
        const std::uint32_t n_fixed = untouched == Untouched::none ? 0 : 37;
        const ForcedBehaviourScope forced(device(), {.coalesces = GetParam()});
        Adam adam(device(), n, {.only_touched = only_touched, .n_fixed = n_fixed}, parameter_set);
        adam.set_max_log_scales(device(), bounds);
        Stream stream(device());
        SurfelArrays parameters(device(), n, "parameters", parameter_set),
            gradients(device(), n, "gradients", parameter_set);
        const Surfels start = make_random_surfels(n, 1, parameter_set);
        parameters.upload(start);
        const auto is_touched = [&](std::uint32_t index, int t) {
            return untouched == Untouched::none || index % 3 == 0 || int(index % 3) == t;
        };
        std::vector<Surfels> g;
        for (int t = 1; t <= 3; ++t) {
            // gradients of untouched rows must not be read
            g.push_back(make_random_surfels(n, 10 + std::uint64_t(t), parameter_set));
            gradients.upload(g.back());
            std::vector<std::uint32_t> touched(n);
            for (std::uint32_t i = 0; i < n; ++i) touched[i] = is_touched(i, t);
            const Array<std::uint32_t, shared::TouchedSurfels> on_device(device(), touched, "touched");
            adam.record_step(stream, parameters, gradients,
                             untouched == Untouched::none ? nullptr : &on_device, kRates, t, 2);
            stream.submit_and_wait();
        }
        const Surfels actual = parameters.download();
        for (std::uint32_t i = 0; i < n; ++i)
            for_each_parameter(start, actual, i, parameter_set,
                               [&](double first, double result, double rate, auto&& gradient) {
                                   Scalar s{first};
                                   if (rate == kRates.log_scale) s.ceiling = double(bounds[i]);
                                   for (int t = 1; t <= 3; ++t)
                                       if (i >= n_fixed && (is_touched(i, t) || !only_touched))
                                           s.step(is_touched(i, t) ? gradient(g[std::size_t(t - 1)]) : 0.0,
                                                  rate, t);
                                   EXPECT_NEAR(result, s.value, 2e-6 * (1.0 + std::abs(s.value)));
                               });
    }
}

TEST(Schedule, IsExponentialBetweenItsEnds) {
    EXPECT_DOUBLE_EQ(interpolate_exp(1e-2, 1e-4, 0, 100), 1e-2);
    EXPECT_NEAR(interpolate_exp(1e-2, 1e-4, 50, 100), 1e-3, 1e-15);
    EXPECT_NEAR(interpolate_exp(1e-2, 1e-4, 100, 100), 1e-4, 1e-16);
    EXPECT_NEAR(interpolate_exp(1e-2, 1e-4, 1000, 100), 1e-4, 1e-16);
}

}  // namespace
}  // namespace relidar
