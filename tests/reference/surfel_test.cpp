// SPDX-License-Identifier: Apache-2.0
// Tests the parts of the reference against closed forms: activations, SH basis (published
// constants, gradient), records, and the intersection (M1, M2) with the cases that it
// rejects.
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "../support/gradient_check.hpp"
#include "surfel.hpp"

namespace relidar::reference {
namespace {

/// Returns a surfel at x = 5 that faces the x axis: a_u = y, a_v = z, normal = x.
/// Standard deviations 0.5 and 0.25 m, opacity 0.8.
Surfel make_facing_surfel() {
    Surfel s;
    s.mean = {5, 0, 0};
    s.rotation = {0.5, 0.5, 0.5, 0.5};  // rotates x -> y -> z -> x
    s.log_scale = {std::log(0.5), std::log(0.25)};
    s.opacity_logit = std::log(4.0);
    return s;
}

TEST(ReferenceSurfel, RotationColumnsOfAKnownQuaternion) {
    const glm::dmat3 r = rotation_matrix({3, 3, 3, 3});  // unnormalised
    EXPECT_NEAR(glm::length(r[0] - glm::dvec3(0, 1, 0)), 0.0, 1e-15);
    EXPECT_NEAR(glm::length(r[1] - glm::dvec3(0, 0, 1)), 0.0, 1e-15);
    EXPECT_NEAR(glm::length(r[2] - glm::dvec3(1, 0, 0)), 0.0, 1e-15);
}

TEST(ReferenceSurfel, RotationAgreesWithGlm) {
    std::mt19937_64 random(5);
    std::normal_distribution<double> normal;
    for (int i = 0; i < 100; ++i) {
        const glm::dvec4 q(normal(random), normal(random), normal(random), normal(random));
        const glm::dmat3 expected = glm::mat3_cast(glm::normalize(glm::dquat(q[0], q[1], q[2], q[3])));
        const glm::dmat3 actual = rotation_matrix(q);
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(glm::length(expected[c] - actual[c]), 0.0, 1e-14);
    }
}

TEST(ReferenceSurfel, ActivationsOfKnownValues) {
    const Activated a = activate(make_facing_surfel());
    EXPECT_DOUBLE_EQ(a.scale.x, 0.5);
    EXPECT_DOUBLE_EQ(a.scale.y, 0.25);
    EXPECT_DOUBLE_EQ(a.opacity, 0.8);
}

TEST(ReferenceSh, ConstantsAreThoseOfGaussianSplatting) {
    const auto b = sh_basis({0, 0, 1}, 3);
    EXPECT_NEAR(b[0], 0.28209479177387814, 1e-15);
    EXPECT_NEAR(b[2], 0.4886025119029199, 1e-15);
    EXPECT_NEAR(b[6], 2 * 0.31539156525252005, 1e-15);
    EXPECT_NEAR(b[12], 2 * 0.3731763325901154, 1e-15);
    const auto c = sh_basis({1, 1, 1}, 3);
    const double expected[16] = {0.28209479177387814,
                                 -0.4886025119029199,
                                 0.4886025119029199,
                                 -0.4886025119029199,
                                 1.0925484305920792,
                                 -1.0925484305920792,
                                 0.0,
                                 -1.0925484305920792,
                                 0.0,
                                 -0.5900435899266435 * 2,
                                 2.890611442640554,
                                 -0.4570457994644658 * 2,
                                 0.3731763325901154 * -4,
                                 -0.4570457994644658 * 2,
                                 0.0,
                                 -0.5900435899266435 * -2};
    for (int k = 0; k < 16; ++k) EXPECT_NEAR(c[k], expected[k], 1e-14) << "coefficient " << k;
    EXPECT_NEAR(sh_basis({1, 0, 0}, 3)[14] + sh_basis({1, 0, 1}, 3)[14], 1.445305721320277, 1e-14);
}

TEST(ReferenceSh, LowerDegreesAreZeroAbove) {
    for (int degree = 0; degree <= 3; ++degree) {
        const auto b = sh_basis({0.3, -0.5, 0.7}, degree);
        const auto g = compute_sh_basis_gradient({0.3, -0.5, 0.7}, degree);
        for (int k = (degree + 1) * (degree + 1); k < 16; ++k) {
            EXPECT_EQ(b[k], 0.0);
            EXPECT_EQ(g[k], glm::dvec3(0.0));
        }
    }
}

TEST(ReferenceSh, GradientAgreesWithDifferences) {
    glm::dvec3 d(0.31, -0.52, 0.83);
    const auto gradient = compute_sh_basis_gradient(d, 3);
    for (int k = 0; k < 16; ++k) {
        const auto slope = test::compute_central_differences(
            &d.x, 3, [&] { return std::vector<double>{sh_basis(d, 3)[k]}; });
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_NEAR(slope[axis], gradient[k][axis], 1e-9) << "coefficient " << k;
    }
}

TEST(ReferenceHit, HeadOnAndOffCentre) {
    const DoubleRecord record = make_record(make_facing_surfel());
    const auto centre = intersect(record, {{0, 0, 0}, {1, 0, 0}}, {});
    ASSERT_TRUE(centre);
    EXPECT_DOUBLE_EQ(centre->t, 5.0);
    EXPECT_DOUBLE_EQ(centre->alpha, 0.8);
    const auto off = intersect(record, {{0, 0.5, -0.5}, {1, 0, 0}}, {});
    ASSERT_TRUE(off);
    EXPECT_NEAR(off->u, 1.0, 1e-14);
    EXPECT_NEAR(off->v, -2.0, 1e-14);
    EXPECT_NEAR(off->alpha, 0.8 * std::exp(-2.5), 1e-14);
    // surfels are two-sided
    const auto behind_the_back = intersect(record, {{10, 0, 0}, {-1, 0, 0}}, {});
    ASSERT_TRUE(behind_the_back);
    EXPECT_DOUBLE_EQ(behind_the_back->t, 5.0);
}

TEST(ReferenceHit, Refusals) {
    const DoubleRecord record = make_record(make_facing_surfel());
    EXPECT_FALSE(intersect(record, {{0, 0, 0}, {-1, 0, 0}}, {})) << "behind the origin";
    EXPECT_FALSE(intersect(record, {{4.85, 0, 0}, {1, 0, 0}}, {})) << "nearer than 0.2 m";
    EXPECT_TRUE(intersect(record, {{4.75, 0, 0}, {1, 0, 0}}, {}));
    EXPECT_FALSE(intersect(record, {{5, -3, 0}, {0, 1, 0}}, {})) << "in the plane";
    const double k = std::sqrt(2.0 * std::log(0.8 / double(1.0f / 255.0f)));
    EXPECT_TRUE(intersect(record, {{0, 0.4999 * k, 0}, {1, 0, 0}}, {}));
    EXPECT_FALSE(intersect(record, {{0, 0.5001 * k, 0}, {1, 0, 0}}, {})) << "alpha under the cut";
}

TEST(ReferenceHit, DegenerateAndNonFiniteSurfelsAreNeverHit) {
    const double nan = std::numeric_limits<double>::quiet_NaN(),
                 inf = std::numeric_limits<double>::infinity();
    std::vector<Surfel> bad(9, make_facing_surfel());
    bad[0].mean.y = nan;
    bad[1].mean.x = inf;
    bad[2].rotation = {0, 0, 0, 0};
    bad[3].rotation.w = nan;
    bad[4].log_scale.x = -inf;  // scale 0
    bad[5].log_scale.y = nan;
    bad[6].opacity_logit = nan;
    bad[7].opacity_logit = std::log((1.0 / 255.0) / (1.0 - 1.0 / 255.0)) - 1e-6;
    bad[8].opacity_logit = -inf;
    for (std::size_t i = 0; i < bad.size(); ++i) {
        EXPECT_FALSE(intersect(make_record(bad[i]), {{0, 0, 0}, {1, 0, 0}}, {})) << "surfel " << i;
        EXPECT_FALSE(intersect(make_float_record(bad[i]), {{0, 0, 0}, {1, 0, 0}}, {})) << "surfel " << i;
    }
    Surfel tiny = make_facing_surfel();
    tiny.log_scale = {-100.0, -100.0};  // 1 / s overflows in float only
    EXPECT_FALSE(intersect(make_float_record(tiny), {{0, 0, 0}, {1, 0, 0}}, {}));
    Surfel huge = make_facing_surfel();
    huge.log_scale = {80.0, 80.0};
    EXPECT_TRUE(intersect(make_float_record(huge), {{0, 3, 4}, {1, 0, 0}}, {}));
}

TEST(ReferenceHit, PoseMovesTheRayIntoTheModel) {
    const Pose pose{glm::angleAxis(0.7, glm::normalize(glm::dvec3(1, -2, 0.5))), {3, -1, 2}};
    const LocalRay<double> local{{0.1, 0.2, -0.3}, glm::normalize(glm::dvec3(1, 0.05, -0.02))};
    const Ray world{pose * local.origin, pose.rotation * local.direction};
    const LocalRay<double> back = to_model(pose, world);
    EXPECT_NEAR(glm::length(back.origin - local.origin), 0.0, 1e-14);
    EXPECT_NEAR(glm::length(back.direction - local.direction), 0.0, 1e-14);
    const LocalRay<float> rounded =
        to_model(make_model_from_world_rows(pose), glm::vec3(world.origin), glm::vec3(world.direction));
    EXPECT_NEAR(glm::length(glm::dvec3(rounded.origin) - local.origin), 0.0, 2e-6);
    const auto exact = intersect(make_record(make_facing_surfel()), back, {});
    const auto single = intersect(make_float_record(make_facing_surfel()), rounded, {});
    ASSERT_TRUE(exact && single);
    EXPECT_NEAR(exact->t, double(single->t), 5e-6);
    EXPECT_NEAR(exact->alpha, double(single->alpha), 5e-6);
}

}  // namespace
}  // namespace relidar::reference
