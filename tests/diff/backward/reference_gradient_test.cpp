// SPDX-License-Identifier: Apache-2.0
// Compares the backward pass of the double reference (M7, M8) with central differences of
// its forward pass (M1-M5).
#include <gtest/gtest.h>

#include "base/parallel.hpp"

#include "../../support/gradient_check.hpp"
#include "../../support/pixel_gradients.hpp"
#include "../../support/random_scene.hpp"

namespace relidar::reference {
namespace {

using test::GradientTable;

struct Problem {
    test::RandomScene scene;
    Settings settings;
    std::vector<PixelGradient> upstream;
    int chunk = 16;

    Problem(ShDirection direction, const test::RandomSceneOptions& options, int chunk_size,
            bool single_drop_logit = false, test::Outputs outputs = test::Outputs::all)
        : chunk(chunk_size) {
        settings.image.sh_direction = direction;
        settings.image.single_drop_logit = single_drop_logit;
        settings.likelihood_scale_m = 0.3;
        scene = test::make_random_scene(options, settings);
        settings.view_origin = scene.view_origin;
        upstream = test::make_random_upstream(scene.rays.size(), options.seed + 1, outputs);
    }

    /// Renders with all hits in one chunk, which is faster than several chunks. A
    /// separate test shows that the chunk size does not change the result.
    double term(const BruteForce& brute, std::size_t index) const {
        const Pixel p = render(scene.world, brute, settings, scene.rays[index], 1000);
        return compute_inner_product(upstream[index], p);
    }
    BruteForce brute() const { return {scene.world, settings.image, Precision::double_record}; }
    std::vector<double> terms() const {
        const BruteForce provider = brute();
        std::vector<double> result;
        for (std::size_t i = 0; i < scene.rays.size(); ++i) result.push_back(term(provider, i));
        return result;
    }
    Gradients gradients(std::vector<RayGradient>& d_rays) const {
        const BruteForce provider = brute();
        Gradients sum(scene.world);
        for (std::size_t i = 0; i < scene.rays.size(); ++i)
            d_rays.push_back(
                backward(scene.world, provider, settings, scene.rays[i], chunk, upstream[i], sum));
        return sum;
    }
};

std::vector<double> row(const double* values, int count) { return {values, values + count}; }
std::vector<double> row(const glm::dvec3& vector) { return {vector.x, vector.y, vector.z}; }

struct Row {
    const char* group;
    std::vector<double> expected, actual;
};

/// Returns the problem with only the rays that hit a surfel. All other rays pass the
/// surfel at a distance (random_scene.hpp), so small changes of the surfel do not affect
/// them.
Problem select_one_surfel(Problem problem, std::size_t surfel) {
    const BruteForce provider = problem.brute();
    std::size_t n_selected_rays = 0;
    for (std::size_t i = 0; i < problem.scene.rays.size(); ++i) {
        const std::vector<Hit> hits = list_all_hits(provider, problem.scene.rays[i], problem.chunk);
        if (std::none_of(hits.begin(), hits.end(), [&](const Hit& hit) { return hit.surfel == surfel; }))
            continue;
        problem.scene.rays[n_selected_rays] = problem.scene.rays[i];
        problem.upstream[n_selected_rays++] = problem.upstream[i];
    }
    problem.scene.rays.resize(n_selected_rays);
    problem.upstream.resize(n_selected_rays);
    return problem;
}

std::vector<Row> make_surfel_rows(const Problem& all, const Gradients& gradients, std::size_t index) {
    Problem p = select_one_surfel(all, index);
    std::vector<Row> rows;
    const auto terms = [&] { return p.terms(); };
    const auto add = [&](const char* group, double* parameter, const double* d_parameter, int count,
                         double step = test::kDifferenceStep) {
        rows.push_back({group, test::compute_central_differences(parameter, count, terms, step),
                        row(d_parameter, count)});
    };
    Surfel& s = p.scene.world.surfels[index];
    const Surfel& d = gradients.surfels[index];
    add("mean", &s.mean.x, &d.mean.x, 3);
    add("rotation", &s.rotation.x, &d.rotation.x, 4);
    add("log_scale", &s.log_scale.x, &d.log_scale.x, 2);
    if (s.log_scale_w) add("log_scale_w", &*s.log_scale_w, &*d.log_scale_w, 1);
    add("opacity_logit", &s.opacity_logit, &d.opacity_logit, 1, test::kLogitStep);
    const char* channels[] = {"sh intensity", "sh hit", "sh drop"};
    for (int c = 0; c < kShChannels; ++c)
        add(channels[c], s.sh.data() + c * kShCoefficients, d.sh.data() + c * kShCoefficients,
            kShCoefficients, test::kLogitStep);
    return rows;
}

void check_surfels(const Problem& problem, const Gradients& gradients, GradientTable& table) {
    std::vector<std::vector<Row>> surfels(problem.scene.world.surfels.size());
    parallel_for(int(surfels.size()), [&](int index) {
        surfels[std::size_t(index)] = make_surfel_rows(problem, gradients, std::size_t(index));
    });
    for (const std::vector<Row>& rows : surfels)
        for (const Row& r : rows) table.add_row(r.group, r.expected, r.actual);
}

void check_rays_and_poses(Problem& problem, const Gradients& gradients,
                          const std::vector<RayGradient>& d_rays, GradientTable& table) {
    const BruteForce provider = problem.brute();
    for (std::size_t i = 0; i < problem.scene.rays.size(); ++i) {
        const auto term = [&] { return std::vector<double>{problem.term(provider, i)}; };
        table.add_row("ray origin",
                      test::compute_central_differences(&problem.scene.rays[i].origin.x, 3, term),
                      row(d_rays[i].origin));
        table.add_row(
            "ray direction",
            test::compute_central_differences(&problem.scene.rays[i].direction.x, 3, term, test::kAngleStep),
            row(d_rays[i].direction));
    }
    const auto terms = [&] { return problem.terms(); };
    table.add_row("view origin", test::compute_central_differences(&problem.settings.view_origin.x, 3, terms),
                  row(gradients.view_origin));
    for (std::size_t i = 0; i < problem.scene.world.instances.size(); ++i) {
        Pose& pose = problem.scene.world.instances[i].world_from_model;
        table.add_row("pose translation", test::compute_central_differences(&pose.translation.x, 3, terms),
                      row(gradients.instances[i].translation));
        const glm::dquat start = pose.rotation;
        const auto rotate_about_axis = [&](int k, double angle) {
            glm::dvec3 axis(0.0);
            axis[k] = 1.0;
            pose.rotation = glm::angleAxis(angle, axis) * start;
        };
        table.add_row("pose rotation",
                      test::compute_central_differences(3, rotate_about_axis, terms, test::kAngleStep),
                      row(gradients.instances[i].rotation));
    }
}

std::size_t most_hits(const Problem& problem) {
    std::size_t most = 0;
    for (const Ray& ray : problem.scene.rays)
        most = std::max<std::size_t>(
            most, render(problem.scene.world, problem.brute(), problem.settings, ray, problem.chunk).hits);
    return most;
}

void expect_differences_agree(ShDirection direction, const test::RandomSceneOptions& options, int chunk,
                              const char* title, bool single_drop_logit = false,
                              test::Outputs outputs = test::Outputs::all) {
    Problem problem(direction, options, chunk, single_drop_logit, outputs);
    EXPECT_GT(most_hits(problem), std::size_t(chunk)) << "the scene should need more than one chunk";
    std::vector<RayGradient> d_rays;
    const Gradients gradients = problem.gradients(d_rays);
    GradientTable table;
    check_surfels(problem, gradients, table);
    check_rays_and_poses(problem, gradients, d_rays, table);
    table.print(title);
    for (const auto& [name, group] : table.groups()) {
        EXPECT_LE(group.compute_worst_error(), test::kReferenceGradient) << name << ", seed " << options.seed;
        EXPECT_EQ(group.count_missing_rows(), 0u) << name;
        // the likelihood does not depend on the channels
        const bool values = outputs == test::Outputs::all;
        const bool constant = (name == "view origin" && !(direction == ShDirection::surfel && values)) ||
                              (name == "sh hit" && single_drop_logit) || (name.starts_with("sh ") && !values);
        EXPECT_EQ(group.count_nonzero_rows() == 0u, constant) << name;
    }
}

TEST(ReferenceGradient, EveryParameterShAlongRay) {
    test::RandomSceneOptions options;
    expect_differences_agree(ShDirection::ray, options, 4, "SH along the ray, 3 instances, chunk 4");
}

TEST(ReferenceGradient, EveryParameterShAlongSurfel) {
    test::RandomSceneOptions options;
    options.seed = 2;
    expect_differences_agree(ShDirection::surfel, options, 4,
                             "SH along sensor -> mean, 3 instances, chunk 4");
}

/// Tests the likelihood of measured ranges (M12) without the image. All other tests
/// include the image.
TEST(ReferenceGradient, LikelihoodAlone) {
    test::RandomSceneOptions options{.seed = 6, .background_surfels = 24, .actor_surfels = 8, .rays = 12};
    expect_differences_agree(ShDirection::surfel, options, 4, "likelihood alone", false,
                             test::Outputs::likelihood);
    options.primitive = PrimitiveType::gaussian;
    expect_differences_agree(ShDirection::ray, options, 4, "likelihood alone, 3D Gaussians", false,
                             test::Outputs::likelihood);
}

TEST(ReferenceGradient, SingleDropLogit) {
    const test::RandomSceneOptions options{
        .seed = 5, .background_surfels = 24, .actor_surfels = 8, .rays = 12};
    expect_differences_agree(ShDirection::ray, options, 4, "one drop logit, SH along the ray, chunk 4", true);
    expect_differences_agree(ShDirection::surfel, options, 4,
                             "one drop logit, SH along sensor -> mean, chunk 4", true);
}

TEST(ReferenceGradient, GaussiansShAlongRay) {
    const test::RandomSceneOptions options{.seed = 6, .primitive = PrimitiveType::gaussian};
    expect_differences_agree(ShDirection::ray, options, 4,
                             "3D Gaussians, SH along the ray, 3 instances, chunk 4");
}

TEST(ReferenceGradient, GaussiansOpaqueShAlongSurfel) {
    const test::RandomSceneOptions options{
        .seed = 7, .opacity_low = 0.5, .opacity_high = 0.98, .primitive = PrimitiveType::gaussian};
    expect_differences_agree(ShDirection::surfel, options, 2,
                             "3D Gaussians, opaque, SH along sensor -> mean, chunk 2");
}

/// Counts the blended hits whose opacity is clamped at alpha_max. Also counts the rays
/// that end because little light passes (T_min).
std::pair<int, int> count_clamps_and_stopped_rays(const Problem& problem) {
    int clamps = 0, stops = 0;
    const BruteForce provider = problem.brute();
    for (const Ray& ray : problem.scene.rays) {
        std::vector<ShadedHit> blended;
        render(problem.scene.world, provider, problem.settings, ray, problem.chunk, &blended);
        for (const ShadedHit& s : blended) clamps += s.alpha_clamped;
        stops += blended.size() < list_all_hits(provider, ray, 16).size();
    }
    return {clamps, stops};
}

TEST(ReferenceGradient, OpaqueSceneThatStopsEarly) {
    const test::RandomSceneOptions options{
        .seed = 3, .wide_surfels = 2, .opacity_low = 0.5, .opacity_high = 0.98};
    const auto [clamps, stops] = count_clamps_and_stopped_rays(Problem(ShDirection::surfel, options, 2));
    EXPECT_GT(clamps, 0);
    EXPECT_GT(stops, 0);
    expect_differences_agree(ShDirection::surfel, options, 2, "opaque, chunk 2");
}

TEST(ReferenceGradient, LongListsChunk16) {
    const test::RandomSceneOptions options{.seed = 4,
                                           .background_surfels = 80,
                                           .actor_surfels = 16,
                                           .rays = 8,
                                           .opacity_low = 0.02,
                                           .opacity_high = 0.2};
    expect_differences_agree(ShDirection::ray, options, 16, "transparent, long lists, chunk 16");
}

TEST(ReferenceGradient, RotationGradientIsTangential) {
    Problem problem(ShDirection::ray, {}, 4);
    std::vector<RayGradient> d_rays;
    const Gradients gradients = problem.gradients(d_rays);
    for (std::size_t i = 0; i < gradients.surfels.size(); ++i) {
        const glm::dvec4 q = problem.scene.world.surfels[i].rotation, d = gradients.surfels[i].rotation;
        EXPECT_LE(std::abs(glm::dot(q, d)), 1e-12 * (1.0 + glm::length(q) * glm::length(d)))
            << "surfel " << i;
    }
}

TEST(ReferenceGradient, ChunkSizeDoesNotMatter) {
    Problem problem(ShDirection::surfel, {}, 1);
    std::vector<RayGradient> d_rays;
    const Gradients one = problem.gradients(d_rays);
    for (const int chunk : {2, 3, 7, 16, 32, 1000}) {
        problem.chunk = chunk;
        const Gradients other = problem.gradients(d_rays);
        for (std::size_t i = 0; i < one.surfels.size(); ++i) {
            EXPECT_EQ(one.surfels[i].mean, other.surfels[i].mean) << "chunk " << chunk;
            EXPECT_EQ(one.surfels[i].sh, other.surfels[i].sh) << "chunk " << chunk;
        }
        for (std::size_t i = 0; i < one.instances.size(); ++i)
            EXPECT_EQ(one.instances[i].rotation, other.instances[i].rotation);
    }
}

}  // namespace
}  // namespace relidar::reference
