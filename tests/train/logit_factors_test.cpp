// SPDX-License-Identifier: Apache-2.0
#include "train/logit_factors.hpp"

#include <gtest/gtest.h>

namespace relidar {
namespace {

/// A background, an actor in all frames, and an actor in every fifth frame.
struct LogitFactors : testing::Test {
    Scene scene;
    std::vector<TrainingFrameData> frames{20};
    TrainConfig config{.iterations = 400, .rays_per_iteration = 250, .sh_rate = 0.1};

    LogitFactors() {
        for (const float half_m : {0.0f, 1.0f, 1.0f}) {
            scene.instances.push_back({std::uint32_t(scene.models.size()), ""});
            scene.models.emplace_back().half_size_m = glm::vec3(half_m);
        }
        for (std::size_t f = 0; f < frames.size(); ++f) {
            frames[f].n_rays = 1000;
            frames[f].placed = {{}, {{}, true}, {{}, f % 5 == 0}};
        }
    }
};

/// The first actor is hit in a quarter of 400 steps, the second in a fifth of these.
TEST_F(LogitFactors, GiveRarelyHitActorsTheSameReach) {
    const std::vector<float> factors = logit_factors(scene, frames, config);
    ASSERT_EQ(factors.size(), 3u);
    EXPECT_EQ(factors[0], 1.0f);
    EXPECT_FLOAT_EQ(factors[1], 50.0f / 100.0f / 0.1f);
    EXPECT_FLOAT_EQ(factors[2], 2.0f / 0.1f) << "2.5 would be above the highest rate";
}

TEST_F(LogitFactors, AreNotNeededInALongTraining) {
    config.iterations = 10'000;
    config.rays_per_iteration = 0;
    frames[0].n_rays = 0;  // an empty scan
    EXPECT_TRUE(logit_factors(scene, frames, config).empty());
}

TEST_F(LogitFactors, DoNotSlowDownAnActor) {
    config.rays_per_iteration = 5000;  // more than a frame has
    config.iterations = 1200;
    const std::vector<float> factors = logit_factors(scene, frames, config);
    ASSERT_EQ(factors.size(), 3u);
    EXPECT_EQ(factors[1], 1.0f);
    EXPECT_FLOAT_EQ(factors[2], 50.0f / 240.0f / 0.1f);
}

}  // namespace
}  // namespace relidar
