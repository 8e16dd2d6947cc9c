// SPDX-License-Identifier: Apache-2.0
// Compares a complete densification (diff/densify/classify, allot, move, spawn) with the
// reference in double.
#include <algorithm>
#include <cstring>
#include <random>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/forward.hpp>
#include <relidar/diff/optimizer.hpp>

#include "../../support/device.hpp"
#include "base/random.hpp"
#include "random_model.hpp"

namespace relidar {
namespace {

using reference::Fate;

constexpr float kAlphaMin = 1.0f / 255.0f;
constexpr std::uint64_t kSeed = 42;
constexpr std::uint32_t kFrames = 40;

struct Case {
    Scene scene;
    DeviceScene device_scene;
    Adam adam;
    DensifyOptions options;
    Densifier densifier;
    Stream stream;
    std::vector<float> gradient_sum;
    std::vector<std::uint32_t> n_observing_batches, frames;
    Surfels moment1, moment2;

    Case(Device& device, Scene initial, const DensifyOptions& o, bool with_poison = false)
        : scene(std::move(initial)),
          device_scene(device, scene),
          adam(device, std::uint32_t(scene.surfels.size()), {}, scene.surfels.primitive),
          options(o),
          densifier(device, scene, options, kAlphaMin, kFrames, kSeed),
          stream(device) {
        if (with_poison) test::fill_with_nan(scene.surfels);
        device_scene.surfel_parameters().upload(scene.surfels);
        std::mt19937 random(3);
        const std::size_t n = scene.surfels.size();
        for (std::size_t i = 0; i < n; ++i) {
            n_observing_batches.push_back(random() % 4);
            // half of the means above 2e-4
            gradient_sum.push_back(float(n_observing_batches[i]) * 1e-4f * float(random() % 1000) / 250.0f);
            for (int k = 0; k < 2; ++k) frames.push_back(random() % 3 ? std::uint32_t(random()) : 0u);
        }
        moment1 = moment2 = scene.surfels;
        for (std::size_t i = 0; i < n; ++i) {
            moment1.opacity_logit[i] = float(i) + 0.25f;
            moment2.opacity_logit[i] = float(i) + 0.5f;
            moment1.mean[i] = moment2.mean[i] = glm::vec3(float(i) + 0.125f);
        }
        show();
        adam.first_moments().upload(moment1);
        adam.second_moments().upload(moment2);
    }

    void show() {
        densifier.statistics().gradient_sum.upload(gradient_sum);
        densifier.statistics().n_observing_batches.upload(n_observing_batches);
        densifier.statistics().frames.upload(frames);
    }
    DensifyReport run(int step) { return densifier.densify_surfels(stream, device_scene, adam, step); }
};

DensifyOptions make_adaptive_options() { return {.strategy = DensifyStrategy::adaptive}; }

std::vector<Fate> compute_expected_fates(const Case& test_case, int step) {
    std::vector<Fate> fates;
    for (std::size_t m = 0; m < test_case.scene.models.size(); ++m) {
        const SurfelModel& model = test_case.scene.models[m];
        const double extent = test_case.densifier.model_extents_m()[m];
        reference::DensifyRules rules;
        rules.min_opacity = std::max(test_case.options.min_opacity, double(kAlphaMin));
        rules.max_scale =
            step > test_case.options.large_from ? test_case.options.max_extent_share * extent : 1e30;
        rules.clone_scale = test_case.options.clone_extent_share * extent;
        rules.gradient_threshold = test_case.options.gradient_threshold;
        rules.half_size = glm::dvec3(model.half_size_m);
        rules.key = std::uint32_t(hash_pair(hash_pair(kSeed, 1), std::uint64_t(step)));
        for (std::uint32_t i = model.first; i < model.first + model.count; ++i)
            fates.push_back(reference::decide_fate(
                test::densify_surfel(test_case.scene.surfels, i),
                test_case.n_observing_batches[i]
                    ? double(test_case.gradient_sum[i]) / test_case.n_observing_batches[i]
                    : 0.0,
                rules, i));
    }
    return fates;
}

bool is_kept(Fate fate) { return fate >= Fate::keep; }

struct Row {
    std::uint32_t source;
    Fate fate;     // Decision for the source surfel. The value is `keep` if the surfel was not copied.
    bool is_copy;  // not the first row of its source
};

std::vector<Row> compute_expected_rows(const std::vector<Fate>& fates, std::uint32_t n_new, int step) {
    std::vector<std::uint32_t> weight;
    std::uint32_t total = 0;
    for (std::size_t i = 0; i < fates.size(); ++i) {
        const bool grows = fates[i] == Fate::clone || fates[i] == Fate::split;
        weight.push_back(grows ? 1u : 0u);
        total += weight.back();
    }
    const std::uint32_t phase =
        total ? std::uint32_t(hash_pair(hash_pair(kSeed, 2), std::uint64_t(step)) % total) : 0u;
    const std::vector<std::uint32_t> copies = reference::count_copies(weight, n_new, phase);
    std::vector<Row> rows;
    for (std::uint32_t i = 0; i < fates.size(); ++i)
        for (std::uint32_t k = 0; is_kept(fates[i]) && k < 1 + copies[i]; ++k)
            rows.push_back({i, copies[i] ? fates[i] : Fate::keep, k > 0});
    return rows;
}

bool are_bits_equal(const float* first, const float* second, std::size_t count) {
    return std::memcmp(first, second, count * sizeof(float)) == 0;
}

void expect_values(const Case& test_case, const Row& row, const Surfels& surfels, std::size_t index,
                   std::uint32_t key) {
    const Surfels& was = test_case.scene.surfels;
    reference::DensifiedSurfel s = test::densify_surfel(was, row.source);
    EXPECT_TRUE(are_bits_equal(&surfels.sh[index * kShFloats], &was.sh[row.source * kShFloats], kShFloats));
    EXPECT_EQ(surfels.rotation[index], was.rotation[row.source]);
    if (row.fate == Fate::split) {
        s.mean = reference::sample_point(s, reference::normal_pair(key, std::uint32_t(index), 2),
                                         reference::normal_pair(key, std::uint32_t(index), 3).x);
        s.scale /= 1.6;
        if (s.scale_w) *s.scale_w /= 1.6;
    } else {
        EXPECT_EQ(surfels.mean[index], was.mean[row.source]);
        EXPECT_EQ(surfels.log_scale[index], was.log_scale[row.source]);
        EXPECT_EQ(surfels.opacity_logit[index], was.opacity_logit[row.source]);
    }
    const reference::DensifiedSurfel actual = test::densify_surfel(surfels, index);
    EXPECT_LT(glm::length(actual.mean - s.mean),
              2e-5 * (glm::length(s.mean) + s.scale.x + s.scale.y + s.scale_w.value_or(0.0)));
    EXPECT_NEAR(actual.scale_w.value_or(1.0) / s.scale_w.value_or(1.0), 1.0, 2e-4);
    EXPECT_LT(glm::length(actual.scale / s.scale - 1.0), 2e-4);
    EXPECT_NEAR(actual.opacity / s.opacity, 1.0, 1e-4);
}

void expect_state(Case& test_case, const std::vector<Row>& rows) {
    const Surfels m1 = test_case.adam.first_moments().download(),
                  m2 = test_case.adam.second_moments().download();
    const SurfelStatistics& s = test_case.densifier.statistics();
    const std::vector<float> sums = s.gradient_sum.download(rows.size());
    const std::vector<std::uint32_t> n_observing_batches = s.n_observing_batches.download(rows.size()),
                                     frames = s.frames.download(2 * rows.size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
        const std::uint32_t from = rows[i].source;
        const bool fresh = rows[i].is_copy || rows[i].fate == Fate::split;
        ASSERT_EQ(m1.opacity_logit[i], fresh ? 0.0f : test_case.moment1.opacity_logit[from]) << i;
        ASSERT_EQ(m2.opacity_logit[i], fresh ? 0.0f : test_case.moment2.opacity_logit[from]) << i;
        ASSERT_EQ(m1.mean[i], fresh ? glm::vec3(0.0f) : test_case.moment1.mean[from]);
        ASSERT_EQ(m2.rotation[i], fresh ? glm::vec4(0.0f) : test_case.moment2.rotation[from]);
        ASSERT_EQ(m1.log_scale[i], fresh ? glm::vec2(0.0f) : test_case.moment1.log_scale[from]);
        if (m1.primitive == PrimitiveType::gaussian) {
            ASSERT_EQ(m1.log_scale_w[i], fresh ? 0.0f : test_case.moment1.log_scale_w[from]);
        }
        ASSERT_EQ(m2.sh[i * kShFloats + 16], fresh ? 0.0f : test_case.moment2.sh[from * kShFloats + 16]);
        ASSERT_EQ(sums[i], 0.0f);
        ASSERT_EQ(n_observing_batches[i], 0u);
        ASSERT_EQ(frames[2 * i], test_case.frames[2 * from]) << "a copy has been seen where its original was";
        ASSERT_EQ(frames[2 * i + 1], test_case.frames[2 * from + 1]);
    }
}

void expect_models(const Case& test_case, const std::vector<Row>& rows) {
    const std::vector<SurfelModel>& now = test_case.device_scene.layout().models;
    ASSERT_EQ(now.size(), test_case.scene.models.size());
    std::uint32_t next = 0;
    for (std::size_t m = 0; m < now.size(); ++m) {
        const SurfelModel& was = test_case.scene.models[m];
        EXPECT_EQ(now[m].first, next);
        EXPECT_EQ(now[m].count, std::count_if(rows.begin(), rows.end(), [&](const Row& r) {
                      return r.source >= was.first && r.source < was.first + was.count;
                  }));
        EXPECT_EQ(now[m].half_size_m, was.half_size_m);
        next += now[m].count;
    }
    EXPECT_EQ(next, test_case.device_scene.size());
}

/// Runs one densification step and compares all results with the reference.
/// @return report of the densification
DensifyReport expect_reference(Case& test_case, int step) {
    const std::vector<Fate> fates = compute_expected_fates(test_case, step);
    const auto count = [&](Fate fate) { return std::uint32_t(std::count(fates.begin(), fates.end(), fate)); };
    const DensifyReport report = test_case.run(step);
    EXPECT_EQ(report.before, fates.size());
    EXPECT_EQ(report.invalid, count(Fate::invalid));
    EXPECT_EQ(report.faint, count(Fate::faint));
    EXPECT_EQ(report.large, count(Fate::large));
    EXPECT_EQ(report.outside, count(Fate::outside));
    EXPECT_EQ(report.clones, count(Fate::clone));
    EXPECT_EQ(report.splits, count(Fate::split));
    const std::vector<Row> rows = compute_expected_rows(fates, report.added, step);
    EXPECT_EQ(report.after, rows.size());
    EXPECT_EQ(test_case.device_scene.size(), rows.size());
    const Surfels now = test_case.device_scene.surfel_parameters().download();
    if (now.size() != rows.size()) return report;
    const std::uint32_t key = std::uint32_t(hash_pair(hash_pair(kSeed, 1), std::uint64_t(step)));
    for (std::size_t i = 0; i < rows.size(); ++i) {
        EXPECT_EQ(test::get_tag(now, i), rows[i].source) << "row " << i;
        expect_values(test_case, rows[i], now, i, key);
        if (testing::Test::HasFailure()) return report;
    }
    expect_state(test_case, rows);
    expect_models(test_case, rows);
    return report;
}

class Densify : public test::DeviceTest {};

TEST_F(Densify, AdaptiveAgreesWithTheReference) {
    for (const int step : {600, 3100}) {
        DensifyOptions options = make_adaptive_options();
        options.clone_extent_share = 3e-3;  // between the scales of the test
        options.max_extent_share = 0.004;
        Case c(device(), test::make_random_model_scene({700, 1, 300, 257}, 11), options, true);
        const DensifyReport r = expect_reference(c, step);
        EXPECT_EQ(r.added, r.clones + r.splits);
        for (const std::uint32_t n : {r.invalid, r.faint, r.outside, r.clones, r.splits})
            EXPECT_GT(n, 10u) << "a case that is not tested";
        if (step > 3000) EXPECT_GT(r.large, 10u);
        else EXPECT_EQ(r.large, 0u);
    }
}

/// Tests Gaussians. The third scale is the largest scale for some of them, and every
/// decision must use it.
TEST_F(Densify, GaussiansAgreeWithTheReference) {
    Scene scene = test::make_random_model_scene({500, 300}, 21);
    convert_surfels(scene.surfels, PrimitiveType::gaussian, 1.5);
    for (std::size_t i = 0; i < scene.surfels.size(); i += 3) scene.surfels.log_scale_w[i] -= 2.0f;
    DensifyOptions options = make_adaptive_options();
    options.clone_extent_share = 3e-3;
    options.max_extent_share = 0.004;
    Case c(device(), scene, options, true);
    const DensifyReport r = expect_reference(c, 3100);
    for (const std::uint32_t n : {r.invalid, r.faint, r.large, r.outside, r.clones, r.splits})
        EXPECT_GT(n, 5u) << "a case that is not tested";
}

TEST_F(Densify, CapIsExactAndSpreadOverTheScene) {
    DensifyOptions options = make_adaptive_options();
    options.max_surfels = 700;
    Case c(device(), test::make_random_model_scene({450, 450}, 14), options);
    const DensifyReport r = expect_reference(c, 600);
    EXPECT_EQ(r.after, 700u);
    EXPECT_LT(r.added, r.clones + r.splits);
    const Surfels now = c.device_scene.surfel_parameters().download();
    std::size_t copies[2]{};
    for (std::size_t i = 1; i < now.size(); ++i)
        copies[test::get_tag(now, i) >= 450] += test::get_tag(now, i) == test::get_tag(now, i - 1);
    EXPECT_GT(copies[0], 0.3 * r.added);
    EXPECT_GT(copies[1], 0.3 * r.added);
    EXPECT_EQ(c.run(700).added, 0u) << "full";
}

TEST_F(Densify, NothingToDoChangesNothing) {
    DensifyOptions options = make_adaptive_options();
    options.gradient_threshold = 1e9;
    Scene scene = test::make_random_model_scene({300, 200}, 15);
    for (float& x : scene.surfels.opacity_logit) x = 1.0f;
    for (SurfelModel& m : scene.models) m.half_size_m = glm::vec3(0.0f);
    Case c(device(), scene, options);
    const auto address = c.device_scene.surfel_parameters().mean.address();
    const DensifyReport r = expect_reference(c, 600);
    EXPECT_EQ(r.n_removed() + r.added, 0u);
    EXPECT_EQ(c.device_scene.surfel_parameters().mean.address(), address);
}

TEST_F(Densify, ModelsAndScenesMayEndEmpty) {
    Scene scene = test::make_random_model_scene({100, 50, 80}, 16);
    for (std::uint32_t i = 100; i < 150; ++i) scene.surfels.opacity_logit[i] = -20.0f;
    Case c(device(), scene, make_adaptive_options());
    expect_reference(c, 600);
    EXPECT_EQ(c.device_scene.layout().models[1].count, 0u);
    EXPECT_GT(c.device_scene.layout().models[2].count, 0u);

    for (float& x : scene.surfels.opacity_logit) x = -20.0f;
    Case all(device(), scene, make_adaptive_options());
    EXPECT_EQ(expect_reference(all, 600).after, 0u);
    EXPECT_EQ(all.run(700).after, 0u) << "and nothing comes of nothing";
    all.densifier.reset_opacities(all.stream, all.device_scene, all.adam, 3000);
    all.stream.submit_and_wait();
    EXPECT_EQ(all.device_scene.surfel_parameters().download().size(), 0u);
}

/// After a densification, training must accept empty models and empty scenes.
TEST_F(Densify, EmptyModelsCanBeTraced) {
    for (const std::vector<std::uint32_t>& counts :
         {std::vector<std::uint32_t>{50, 0, 20}, std::vector<std::uint32_t>{0, 0}}) {
        Renderer renderer(device(), test::make_random_model_scene(counts, 20), {});
        renderer.update(glm::vec3(0.0f));
        WorldRays rays;
        rays.origin = {glm::vec3(0.0f)};
        rays.direction = {glm::vec3(1.0f, 0.0f, 0.0f)};
        EXPECT_EQ(renderer.render_rays(rays).size(), 1u);
    }
}

TEST_F(Densify, RunsAreEqualBitByBit) {
    std::vector<Surfels> results;
    for (int run = 0; run < 2; ++run) {
        Case c(device(), test::make_random_model_scene({400, 300}, 17), make_adaptive_options(), true);
        c.run(600);
        c.densifier.statistics().gradient_sum.upload(std::vector<float>(c.device_scene.size(), 1.0f));
        c.densifier.statistics().n_observing_batches.upload(
            std::vector<std::uint32_t>(c.device_scene.size(), 2u));
        c.run(700);
        results.push_back(c.device_scene.surfel_parameters().download());
    }
    ASSERT_GT(results[0].size(), 700u);
    EXPECT_EQ(results[0].mean, results[1].mean);
    EXPECT_EQ(results[0].log_scale, results[1].log_scale);
    EXPECT_EQ(results[0].sh, results[1].sh);
}

TEST_F(Densify, IsDueAsThePaperSays) {
    Case c(device(), test::make_random_model_scene({10}, 19), make_adaptive_options());
    for (const int step : {500, 600, 14900}) EXPECT_TRUE(c.densifier.is_densify_step(step)) << step;
    for (const int step : {100, 400, 550, 15000, 20000})
        EXPECT_FALSE(c.densifier.is_densify_step(step)) << step;
}

}  // namespace
}  // namespace relidar
