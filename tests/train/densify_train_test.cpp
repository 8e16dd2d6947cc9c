// SPDX-License-Identifier: Apache-2.0
// Tests densification in training, which starts from an eighth of the points. If surfels
// that are visible in no frame are removed, the image must not change.
#include <map>

#include <relidar/read/dataset.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

class DensifyTrain : public test::DeviceTest {};

Log make_growing_street() { return make_street_log({.n_frames = 11, .rows = 16, .columns = 256}); }

Config make_sparse_config() {
    Config config = make_preset("quick");
    config.init.voxel_m = 1.2;
    config.init.max_scale_m = 1.0;
    config.init.scale_factor = 0.7;
    config.init.opacity = 0.3;
    config.train.iterations = 160;
    config.train.rays_per_iteration = 2048;
    config.train.log_every = 10;
    config.train.mean_rate = 1e-4;  // allows the two halves of a split surfel to move apart
    config.train.mean_rate_final = 1e-5;
    config.train.rate_decay = 0.3;
    // With larger rates, a few surfels would stretch over the holes, and new surfels
    // would lag behind.
    config.train.opacity_rate = 0.05;
    config.train.scale_rate = 1e-2;
    config.train.rotation_rate = 3e-4;
    config.train.sh_rate = 3e-2;
    config.densify.from = 20;
    config.densify.every = 20;
    config.densify.until = 81;
    config.densify.gradient_threshold = 5e-4;
    return config;
}

double get_final_loss(const TrainResult& result) {
    double sum = 0.0;
    for (std::size_t i = result.log.size() - 3; i < result.log.size(); ++i) sum += result.log[i].loss / 3.0;
    return sum;
}

TEST_F(DensifyTrain, GrowthLowersTheLoss) {
    const Log sequence = make_growing_street();
    const Split split = split_frames(sequence, 10);
    std::map<DensifyStrategy, double> loss;
    for (const DensifyStrategy strategy : {DensifyStrategy::none, DensifyStrategy::adaptive}) {
        Config config = make_sparse_config();
        config.densify.strategy = strategy;
        const TrainResult result = train(device(), sequence, split, config);
        loss[strategy] = get_final_loss(result);
        std::uint32_t n = result.log.front().n_surfels;
        for (const TrainProgress& line : result.log) {
            n = n + line.densified.added - line.densified.n_removed();
            EXPECT_EQ(line.n_surfels, n) << "the log accounts for every surfel";
        }
        EXPECT_EQ(result.scene.surfels.size(), n);
        EXPECT_GE(n, strategy == DensifyStrategy::none ? 1u : result.log.front().n_surfels * 11 / 10);
    }
    EXPECT_LT(loss[DensifyStrategy::adaptive], loss[DensifyStrategy::none]);
}

TEST_F(DensifyTrain, ActorsStayInTheirModels) {
    const Log sequence = make_growing_street();
    const Split split = split_frames(sequence, 10);
    Config config = make_sparse_config();
    config.init.actor_classes = "Car";
    config.init.actor_min_points = 20;
    config.init.voxel_m = 0.6;
    config.train.iterations = 20;
    config.densify.strategy = DensifyStrategy::adaptive;
    config.densify.from = config.densify.every = 10;
    const Scene scene = train(device(), sequence, split, config).scene;
    ASSERT_EQ(scene.models.size(), 3u);
    std::uint32_t next = 0;
    for (const SurfelModel& model : scene.models) {
        EXPECT_EQ(model.first, next);
        EXPECT_GT(model.count, 10u);
        next += model.count;
    }
    EXPECT_EQ(next, scene.surfels.size());
    for (std::size_t m = 1; m < 3; ++m)
        for (std::uint32_t i = 0; i < scene.models[m].count; ++i)
            ASSERT_LT(glm::length(scene.surfels.mean[scene.models[m].first + i]), 6.0f);
}

TEST_F(DensifyTrain, OutOfMemoryEndsGrowthNotTraining) {
    const Log sequence = make_growing_street();
    const Split split = split_frames(sequence, 10);
    Config config = make_sparse_config();
    config.train.iterations = 40;
    config.densify.from = config.densify.every = 5;
    config.densify.strategy = DensifyStrategy::adaptive;
    config.densify.gradient_threshold = 0.0;  // every visible surfel grows
    std::uint64_t needed = 0;
    {
        Device unlimited;
        train(unlimited, sequence, split, config,
              [](const TrainProgress& progress) { return progress.iteration < 1; });
        needed = unlimited.peak_bytes();
    }
    Device limited({.memory_limit_bytes = needed + (std::uint64_t(2) << 20)});
    const TrainResult result = train(limited, sequence, split, config);
    EXPECT_EQ(result.log.back().iteration, 40);
    EXPECT_FALSE(result.interrupted);
    EXPECT_GT(result.scene.surfels.size(), result.log.front().n_surfels);
    EXPECT_LT(result.scene.surfels.size(), 4u * result.log.front().n_surfels)
        << "without a limit it doubles at each of seven times";
    int notes = 0;
    for (const TrainProgress& line : result.log) notes += !line.densified.note.empty();
    EXPECT_EQ(notes, 1);
}

}  // namespace
}  // namespace relidar
