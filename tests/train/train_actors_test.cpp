// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <vector>

#include <gmock/gmock.h>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"

namespace relidar {
namespace {

class TrainActors : public test::DeviceTest {
protected:
    /// Two blocks, x < 0 and x >= 0. The cars are thin, so that rays pass through.
    void SetUp() override {
        DeviceTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        run.folder = folder;
        run.log = make_street_log({.n_frames = 11, .rows = 24, .columns = 384});
        run.split = split_frames(run.log, 10);
        run.config = make_preset("quick");
        run.config.init.voxel_m = 0.3;
        run.config.init.actor_min_points = 10;
        // large enough to close the holes between the points of a car
        run.config.init.scale_factor = 0.8;
        run.config.train.deterministic = true;
        run.config.blocks.actor_epochs = 4;
        Scene full_scene = init_scene(run.log, run.split.train, run.config.init);
        for (std::size_t i = 0; i < full_scene.surfels.size(); ++i)
            full_scene.surfels.opacity_logit[i] = i < full_scene.models[0].count ? 6.0f : -1.5f;
        run.scene = replace_background(full_scene, {});
        for (const bool right : {false, true}) run.scene.blocks.push_back(save_half(full_scene, right));
    }

    SceneBlock save_half(const Scene& scene, bool right) {
        std::vector<std::uint32_t> order;
        for (std::uint32_t i = 0; i < scene.models[0].count; ++i)
            if ((scene.surfels.mean[i].x >= 0.0f) == right) order.push_back(i);
        const Scene half = wrap_background(scene.surfels.reorder(order));
        SceneBlock block{folder / (right ? "right.safetensors" : "left.safetensors"), half.models[0].count,
                         half.surfels.mean[0], half.surfels.mean[0]};
        for (const glm::vec3& mean : half.surfels.mean) {
            block.low_m = glm::min(block.low_m, mean);
            block.high_m = glm::max(block.high_m, mean);
        }
        save_model(block.file, half);
        return block;
    }

    /// Median error of the mean range on a held-out frame, of rays with a return from a
    /// car.
    double measure_error_on_cars() {
        const Frame& frame = run.log.frames[std::size_t(run.split.test[0])];
        ScanRenderer renderer(device(), run.scene, run.config, run.log);
        const RenderedScan scan = renderer.render({frame.scan.rays, std::nullopt}, frame.time_s);
        std::vector<double> errors;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const WorldReturn at = locate_return(run.log, frame, i);
            if (!is_in_moving_box(run.log.boxes, at.point_m, at.time_s, -0.05)) continue;
            errors.push_back(std::abs(scan.image.range_m[i] - frame.scan.range_m[i]));
        }
        EXPECT_GT(errors.size(), 20u) << "the cars must be seen";
        std::sort(errors.begin(), errors.end());
        return errors.empty() ? 0.0 : errors[errors.size() / 2];
    }

    ScratchFolder scratch;
    const std::filesystem::path folder = scratch.path;
    relidar::Run run;
};

TEST_F(TrainActors, CloseUpBeforeTheJoinedBackgroundWhichStays) {
    run.config.blocks.actor_epochs = 20;
    const double before = measure_error_on_cars();
    const Scene was = run.scene;
    int last = 0, expected = 0;
    const auto count = [&](int step, int n_steps) {
        EXPECT_EQ(step, ++last);
        expected = n_steps;
    };
    EXPECT_EQ(train_actors(device(), run, {count, {}}), TrainingEndReason::finished);
    EXPECT_EQ(last, expected);
    EXPECT_EQ(last, 20 * int(run.split.train.size())) << "a car is seen in every frame";
    const double after = measure_error_on_cars();
    EXPECT_GT(before, 0.5) << "they must be thin, or there is nothing to learn";
    EXPECT_LT(after, 0.3 * before);

    EXPECT_EQ(run.scene.models[0].count, 0u) << "the background stays in its files";
    ASSERT_EQ(run.scene.surfels.size(), was.surfels.size());
    EXPECT_NE(run.scene.surfels.opacity_logit, was.surfels.opacity_logit);
}

TEST_F(TrainActors, LeaveABackgroundInMemoryAsItIs) {
    run.scene = with_all_blocks(run.scene);
    const Scene was = run.scene;
    const std::size_t n = was.models[0].count;
    ASSERT_GT(n, 1000u);
    EXPECT_EQ(train_actors(device(), run), TrainingEndReason::finished);
    const auto same = [&](auto Surfels::*field) {
        const auto &a = was.surfels.*field, &b = run.scene.surfels.*field;
        ASSERT_EQ(a.size(), b.size());
        const std::ptrdiff_t floats = std::ptrdiff_t(a.size() / was.surfels.size() * n);
        EXPECT_TRUE(std::equal(a.begin(), a.begin() + floats, b.begin()));
        EXPECT_FALSE(std::equal(a.begin() + floats, a.end(), b.begin() + floats)) << "actors learn";
    };
    same(&Surfels::mean);
    same(&Surfels::rotation);
    same(&Surfels::log_scale);
    same(&Surfels::opacity_logit);
    same(&Surfels::sh);
}

/// Surfels high above the street must not change any bit of the result.
TEST_F(TrainActors, WhatNoRayNearThemMeetsMakesNoDifference) {
    relidar::Run other = run;
    Surfels far = load_block(run.scene.blocks[0]).slice(0, 100);
    for (glm::vec3& mean : far.mean) mean += glm::vec3(0.0f, 0.0f, 60.0f);  // above the street
    const Scene above = wrap_background(far);
    SceneBlock block{folder / "above.safetensors", 100, {-100, -100, -100}, {100, 100, 100}};
    save_model(block.file, above);
    other.scene.blocks.push_back(block);
    // excludes the learning rate of means, because it depends on the extent of all blocks
    for (relidar::Run* each : {&run, &other})
        each->config.train.mean_rate = each->config.train.mean_rate_final = 0.0;
    EXPECT_EQ(train_actors(device(), run), TrainingEndReason::finished);
    EXPECT_EQ(train_actors(device(), other), TrainingEndReason::finished);
    EXPECT_EQ(run.scene.surfels.opacity_logit, other.scene.surfels.opacity_logit);
    EXPECT_EQ(run.scene.surfels.sh, other.scene.surfels.sh);
}

TEST_F(TrainActors, StopWhenAskedAndDoNothingWhenTurnedOff) {
    const Scene was = run.scene;
    EXPECT_EQ(train_actors(device(), run, {{}, [] { return true; }}), TrainingEndReason::stopped);
    EXPECT_EQ(run.scene.surfels.mean, was.surfels.mean) << "half a training is none";
    run.config.blocks.actor_epochs = 0;
    EXPECT_EQ(train_actors(device(), run), TrainingEndReason::finished);
    EXPECT_EQ(run.scene.surfels.mean, was.surfels.mean);
}

}  // namespace
}  // namespace relidar
