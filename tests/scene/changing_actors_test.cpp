// SPDX-License-Identifier: Apache-2.0
// Tests actors that change their shape. Each surfel of such an actor is visible only
// around the time of its frame (docs/method.md M14).
#include "scene/changing_actors.hpp"
#include <relidar/scene/labels.hpp>

#include <cmath>

#include <gtest/gtest.h>

namespace relidar {
namespace {

/// Points of a static wall and of a door that opens suddenly. The actor moves by 10 cm
/// per frame.
std::vector<LidarSample> make_points_of_door() {
    std::vector<LidarSample> samples;
    for (int frame = 0; frame < 20; ++frame)
        for (float x = 0.0f; x < 1.0f; x += 0.1f)
            for (float z = 0.0f; z < 1.0f; z += 0.1f)
                for (const float y : {frame < 10 ? 0.0f : 0.5f, 1.0f})
                    samples.push_back({{x, y, z}, 0.5f, {0.0f, 1.0f, 0.0f}, 0.1f * float(frame), frame});
    return samples;
}

TEST(ChangingSurfels, ADoorIsOpenOnlyWhenItWasOpen) {
    const DeformingActorSurfels actor = make_deforming(make_points_of_door(), {}, 0.0, 8000);
    // Returns the highest visibility (M14) of the surfels at a distance y in a frame.
    const auto visible = [&](double frame, float y) {
        double most = 0.0;
        for (std::size_t i = 0; i < actor.surfels.size(); ++i) {
            const GaitPhaseWindow& gait = actor.surfels.gait[i];
            const double turns = 0.1 * frame / actor.period_m - double(gait.phase), k = gait.sharpness;
            if (std::abs(actor.surfels.mean[i].y - y) < 0.01f)
                most = std::max(most, std::exp(k * k * (std::cos(2.0 * kPi * turns) - 1.0)));
        }
        return most;
    };
    for (const double frame : {0.0, 4.0, 15.0, 19.0}) {
        EXPECT_GT(visible(frame, frame < 10.0 ? 0.0f : 0.5f), 0.99) << frame;
        EXPECT_LT(visible(frame, frame < 10.0 ? 0.5f : 0.0f), 0.02) << frame;
        EXPECT_EQ(visible(frame, 1.0f), 1.0) << "the wall is always visible";
    }
    EXPECT_NEAR(visible(4.5, 0.0f), std::exp(-0.125), 1e-3) << "half a standard deviation";
    EXPECT_EQ(make_deforming({make_points_of_door().front()}, {}, 0.0, 8000).surfels.size(), 0u);
}

/// A limb moves as far as the actor walks. Between two frames, the surfels of both must
/// meet at its exact position.
TEST(ChangingSurfels, ALimbMovesBetweenFrames) {
    std::vector<LidarSample> samples;
    for (int frame = 0; frame < 20; ++frame)
        for (float y = -0.2f; y < 0.21f; y += 0.04f)
            for (float z = -0.2f; z < 0.21f; z += 0.04f)
                samples.push_back(
                    {{0.1f * float(frame), y, z}, 0.5f, {-1.0f, 0.0f, 0.0f}, 0.1f * float(frame), frame});
    const DeformingActorSurfels actor = make_deforming(samples, {}, 0.0, 8000);
    int n_visible = 0;
    for (std::size_t i = 0; i < actor.surfels.size(); ++i) {
        const GaitPhaseWindow& gait = actor.surfels.gait[i];
        const double turns = 0.45 / actor.period_m - double(gait.phase), k = gait.sharpness;
        if (std::exp(k * k * (std::cos(2.0 * kPi * turns) - 1.0)) < 0.8) continue;
        ++n_visible;
        EXPECT_NEAR(actor.surfels.mean[i].x + gait.swing.x * std::sin(2.0 * kPi * turns), 0.45, 0.012) << i;
        EXPECT_EQ(gait.swing.z, 0.0f);
    }
    EXPECT_GT(n_visible, 20);
}

/// The walked distance is constant and cannot drive a motion.
TEST(ChangingSurfels, AnActorThatStandsIsRigid) {
    std::vector<LidarSample> samples = make_points_of_door();
    for (LidarSample& sample : samples) sample.walked_m = 0.0f;
    EXPECT_EQ(make_deforming(samples, {}, 0.0, 8000).period_m, 0.0);
}

/// Evaluates M14 at all phases of the walk.
TEST(ChangingSurfels, FadeBeforeTheySwingOutOfTheBox) {
    constexpr float kAlphaMin = 0.02f;
    Scene scene = wrap_background({});
    Surfels& surfels = scene.surfels;
    surfels.resize(4, {PrimitiveType::surfel, true});
    surfels.mean = {{0.3f, 0.0f, 0.0f}, {-0.1f, 0.0f, 0.8f}, {0.0f, 0.2f, 0.0f}, {0.3f, 0.0f, 0.0f}};
    surfels.gait = {{0.1f, 0.5f, {9.0f, 0.0f, 0.0f}},
                    {0.6f, 3.0f, {-1.0f, 0.0f, 0.5f}},
                    {0.3f, 2.0f, {0.4f, 0.3f, 0.0f}},
                    {0.2f, 0.5f, {9.0f, 0.0f, 0.0f}}};
    surfels.opacity_logit = {2.0f, 0.0f, 4.0f, 2.0f};
    const glm::vec3 half_m(0.6f, 0.5f, 1.0f);
    scene.models = {{"background", 0, 0}, {"walker", 0, 3, half_m, 5.0f}, {"rigid", 3, 1, half_m}};
    const std::vector<GaitPhaseWindow> before = surfels.gait;
    fade_far_swings(scene, kAlphaMin);
    int n_visible = 0;
    for (std::size_t i = 0; i < 3; ++i)
        for (double phase = 0.0; phase < 1.0; phase += 1e-3) {
            const GaitPhaseWindow& gait = surfels.gait[i];
            const double angle = 2.0 * kPi * (phase - double(gait.phase)), k = gait.sharpness,
                         opacity = std::exp(k * k * (std::cos(angle) - 1.0)) /
                                   (1.0 + std::exp(-double(surfels.opacity_logit[i])));
            const glm::dvec3 centre_m =
                glm::dvec3(surfels.mean[i]) + std::sin(angle) * glm::dvec3(gait.swing);
            const glm::dvec3 outside_m = glm::abs(centre_m) - glm::dvec3(half_m) - 0.1;
            if (opacity <= double(kAlphaMin) + 1e-6) continue;
            ++n_visible;
            EXPECT_LE(std::max({outside_m.x, outside_m.y, outside_m.z}), 1e-5) << i << " at " << phase;
        }
    EXPECT_GT(n_visible, 100);
    EXPECT_GT(surfels.gait[0].sharpness, before[0].sharpness);
    EXPECT_EQ(surfels.gait[2].sharpness, before[2].sharpness) << "it stays in the box";
    EXPECT_EQ(surfels.gait[3].sharpness, before[3].sharpness) << "its model does not walk";
}

}  // namespace
}  // namespace relidar
