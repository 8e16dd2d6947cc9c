// SPDX-License-Identifier: Apache-2.0
// Compares the backward pass of the double reference (M7, M8) with central differences of
// its forward pass (M1-M5).
#include <gtest/gtest.h>

#include "base/parallel.hpp"

#include "../../support/gradient_check.hpp"
#include "../../support/pixel_gradients.hpp"

namespace relidar::reference {
namespace {

using test::GradientProblem;
using test::GradientTable;
using test::Outputs;

/// Returns the problem with only the rays that hit a surfel. All other rays pass the
/// surfel at a distance (random_scene.hpp), so small changes of the surfel do not affect
/// them.
GradientProblem select_one_surfel(GradientProblem problem, std::size_t surfel) {
    const BruteForce brute(problem.scene.world, problem.settings.image, Precision::double_record);
    std::size_t n_selected_rays = 0;
    for (std::size_t i = 0; i < problem.scene.rays.size(); ++i) {
        const std::vector<Hit> hits = brute.list_hits(problem.scene.rays[i]);
        if (std::ranges::find(hits, surfel, &Hit::surfel) == hits.end()) continue;
        problem.scene.rays[n_selected_rays] = problem.scene.rays[i];
        problem.upstream[n_selected_rays++] = problem.upstream[i];
    }
    problem.scene.rays.resize(n_selected_rays);
    problem.upstream.resize(n_selected_rays);
    return problem;
}

GradientTable compare_surfel(const GradientProblem& all, const Gradients& gradients, std::size_t index) {
    GradientProblem p = select_one_surfel(all, index);
    GradientTable table;
    const auto add = [&](const char* group, double* parameter, const double* d_parameter, int count,
                         double step = test::kDifferenceStep) {
        add_differences(
            table, group, parameter, d_parameter, count, [&] { return p.terms(); }, step);
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
    return table;
}

void compare_surfels(const GradientProblem& problem, const Gradients& gradients, GradientTable& table) {
    std::vector<GradientTable> surfels(problem.scene.world.surfels.size());
    parallel_for(int(surfels.size()), [&](int index) {
        surfels[std::size_t(index)] = compare_surfel(problem, gradients, std::size_t(index));
    });
    for (const GradientTable& of_surfel : surfels) table.add_table(of_surfel);
}

void compare_rays_and_poses(GradientProblem& problem, const Gradients& gradients, GradientTable& table) {
    GradientProblem single = problem;  // with one ray
    for (std::size_t i = 0; i < problem.scene.rays.size(); ++i) {
        single.scene.rays = {problem.scene.rays[i]};
        single.upstream = {problem.upstream[i]};
        Ray& ray = single.scene.rays[0];
        const RayGradient& d = gradients.rays[i];
        const auto term = [&] { return single.terms(); };
        add_differences(table, "ray origin", &ray.origin.x, &d.origin.x, 3, term);
        add_differences(table, "ray direction", &ray.direction.x, &d.direction.x, 3, term, test::kAngleStep);
    }
    const auto terms = [&] { return problem.terms(); };
    add_differences(table, "view origin", &problem.settings.view_origin.x, &gradients.view_origin.x, 3,
                    terms);
    for (std::size_t i = 0; i < problem.scene.world.instances.size(); ++i) {
        Pose& pose = problem.scene.world.instances[i].world_from_model;
        const PoseGradient& d = gradients.instances[i];
        add_differences(table, "pose translation", &pose.translation.x, &d.translation.x, 3, terms);
        const glm::dquat start = pose.rotation;
        const auto rotate_about_axis = [&](int k, double angle) {
            glm::dvec3 axis(0.0);
            axis[k] = 1.0;
            pose.rotation = glm::angleAxis(angle, axis) * start;
        };
        table.add_row("pose rotation",
                      test::compute_central_differences(3, rotate_about_axis, terms, test::kAngleStep),
                      {d.rotation.x, d.rotation.y, d.rotation.z});
    }
}

struct GradientCase {
    const char* name;
    ShDirection direction;
    test::RandomSceneOptions options;
    bool single_drop_logit = false;
    Outputs outputs = Outputs::all;
};
void PrintTo(const GradientCase& c, std::ostream* out) { *out << c.name; }
constexpr PrimitiveType kGaussian = PrimitiveType::gaussian;
/// The likelihood (M12) is also tested without the image, which all other cases include.
const GradientCase kGradientCases[] = {
    {"ShAlongRay", ShDirection::ray, {}},
    {"ShAlongSurfel", ShDirection::surfel, {.seed = 2}},
    {"Likelihood",
     ShDirection::surfel,
     {.seed = 6, .background_surfels = 24, .actor_surfels = 8, .rays = 12},
     false,
     Outputs::likelihood},
    {"LikelihoodOfGaussians",
     ShDirection::ray,
     {.seed = 6, .background_surfels = 24, .actor_surfels = 8, .rays = 12, .primitive = kGaussian},
     false,
     Outputs::likelihood},
    {"SingleDropLogitAlongRay",
     ShDirection::ray,
     {.seed = 5, .background_surfels = 24, .actor_surfels = 8, .rays = 12},
     true},
    {"SingleDropLogitAlongSurfel",
     ShDirection::surfel,
     {.seed = 5, .background_surfels = 24, .actor_surfels = 8, .rays = 12},
     true},
    {"Gaussians", ShDirection::ray, {.seed = 6, .primitive = kGaussian}},
    {"OpaqueGaussians",
     ShDirection::surfel,
     {.seed = 7, .opacity_low = 0.5, .opacity_high = 0.98, .primitive = kGaussian}},
    {"OpaqueWithEarlyStop",
     ShDirection::surfel,
     {.seed = 3, .wide_surfels = 2, .opacity_low = 0.5, .opacity_high = 0.98}},
    {"LongLists",
     ShDirection::ray,
     {.seed = 4,
      .background_surfels = 80,
      .actor_surfels = 16,
      .rays = 8,
      .opacity_low = 0.02,
      .opacity_high = 0.2}}};

class ReferenceGradient : public testing::TestWithParam<GradientCase> {};
INSTANTIATE_TEST_SUITE_P(Cases, ReferenceGradient, testing::ValuesIn(kGradientCases),
                         [](const auto& tested) { return std::string(tested.param.name); });

TEST_P(ReferenceGradient, EqualsDifferences) {
    const GradientCase& c = GetParam();
    GradientProblem problem({.sh_direction = c.direction, .single_drop_logit = c.single_drop_logit},
                            c.options, c.outputs);
    const std::vector<Pixel> pixels = render(problem.scene.world, problem.settings, problem.scene.rays);
    EXPECT_GT(std::ranges::max(pixels, {}, &Pixel::hits).hits, 2u);
    const Gradients gradients = problem.gradients();
    GradientTable table;
    compare_surfels(problem, gradients, table);
    compare_rays_and_poses(problem, gradients, table);
    table.print(c.name);
    for (const auto& [name, group] : table.groups()) {
        EXPECT_LE(group.compute_worst_error(), test::kReferenceGradient) << name;
        EXPECT_EQ(group.count_missing_rows(), 0u) << name;
        // the likelihood does not depend on the channels
        const bool values = c.outputs == Outputs::all;
        const bool constant = (name == "view origin" && !(c.direction == ShDirection::surfel && values)) ||
                              (name == "sh hit" && c.single_drop_logit) ||
                              (name.starts_with("sh ") && !values);
        EXPECT_EQ(group.count_nonzero_rows() == 0u, constant) << name;
    }
}

/// The opaque case must clamp opacities at alpha_max, and stop rays because little light
/// passes (T_min).
TEST(ReferenceGradientCases, ClampAndStop) {
    const GradientCase& c = *std::ranges::find(kGradientCases, std::string("OpaqueWithEarlyStop"),
                                               [](const GradientCase& one) { return one.name; });
    const GradientProblem problem({.sh_direction = c.direction}, c.options);
    const BruteForce brute(problem.scene.world, problem.settings.image, Precision::double_record);
    int clamps = 0, stops = 0;
    for (const Ray& ray : problem.scene.rays) {
        std::vector<ShadedHit> blended;
        render(problem.scene.world, brute, problem.settings, ray, &blended);
        for (const ShadedHit& s : blended) clamps += s.alpha_clamped;
        stops += blended.size() < brute.list_hits(ray).size();
    }
    EXPECT_GT(clamps, 0);
    EXPECT_GT(stops, 0);
}

TEST(ReferenceGradientCases, RotationGradientIsTangential) {
    const GradientProblem problem({}, {}, Outputs::all);
    const Gradients gradients = problem.gradients();
    for (std::size_t i = 0; i < gradients.surfels.size(); ++i) {
        const glm::dvec4 q = problem.scene.world.surfels[i].rotation, d = gradients.surfels[i].rotation;
        EXPECT_LE(std::abs(glm::dot(q, d)), 1e-12 * (1.0 + glm::length(q) * glm::length(d)))
            << "surfel " << i;
    }
}

}  // namespace
}  // namespace relidar::reference
