// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <relidar/read/dataset.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

class Losses : public test::DeviceTest {};

TEST_F(Losses, EveryTermIsLogged) {
    const Log street = make_street_log({.n_frames = 5, .rows = 16, .columns = 256});
    for (const std::string batch : {"columns", "rays"}) {
        Config config = make_preset("quick");
        config.init.voxel_m = 0.4;
        config.init.actor_min_points = 20;
        config.init.max_scale_m = 2.0;
        config.loss.intensity_ssim = batch == "columns" ? 0.15f : 0.0f;
        config.loss.chamfer = 0.01f;
        config.loss.box = config.loss.likelihood = 0.01f;
        config.loss.box_scale_share = 0.01f;  // so that some surfel is too large
        config.train.iterations = 3;
        config.train.rays_per_iteration = 1024;
        const TrainResult result = train(device(), street, split_frames(street, 0), config);
        ASSERT_GT(result.scene.models.size(), 1u) << "an actor";
        for (std::size_t k = 0; k < kLossTerms; ++k) {
            const double term = result.log.back().terms[k];
            const bool off = k == loss_term::custom || (batch == "rays" && k == loss_term::ssim);
            EXPECT_TRUE(std::isfinite(term) && (term > 0.0) != off);
        }
    }
}

}  // namespace
}  // namespace relidar
