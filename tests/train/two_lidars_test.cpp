// SPDX-License-Identifier: Apache-2.0
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "../support/two_lidars.hpp"

namespace relidar {
namespace {

class TwoLidars : public test::DeviceTest {};

Config make_two_lidar_config() {
    Config config = make_preset("quick");
    config.init.voxel_m = 0.4;
    config.train.rays_per_iteration = 0;
    config.train.log_every = 10;
    config.train.sensor_drop = true;
    config.train.refine_poses = "sensor";
    return config;
}

/// Mean absolute depth error on the nominal rays of a held-out frame.
double measure_held_out_error(Device& device, const Scene& scene, const Config& config, const Log& street,
                              const Frame& frame) {
    ScanRenderer renderer(device, scene, config, street);
    const RenderedScan scan = renderer.render(make_sensor(config, street, frame.lidar), frame.time_s);
    return evaluate(scan.image, measured_image(config, frame.scan)).at("strict/depth_mae_m");
}

TEST_F(TwoLidars, TrainTogetherAndRenderEach) {
    Log street = test::make_two_lidar_street({.n_frames = 11, .rows = 16, .columns = 256});
    const Split split = split_frames(street, 10);
    Config config = make_two_lidar_config();
    std::string report_text;
    prepare_log(street, split, config,
                {[&](const std::string& text) { report_text += text + "\n"; }, {}, {}});
    EXPECT_NE(report_text.find("registered"), std::string::npos) << report_text;
    const auto trained = [&](int iterations) {
        config.train.iterations = iterations;
        return train(device(), street, split, config);
    };
    const TrainResult result = trained(60), untrained = trained(0);
    EXPECT_LT(result.log.back().loss, 0.7 * result.log.front().loss);
    EXPECT_EQ(result.scene.sensor_drop.channels, 24);
    ASSERT_TRUE(result.poses);
    EXPECT_EQ(result.poses->world_from_vehicle.pose.size(), 11u);
    for (const int position : split.test) {
        const Frame& frame = street.frames[std::size_t(position)];
        const double before = measure_held_out_error(device(), untrained.scene, config, street, frame),
                     after = measure_held_out_error(device(), result.scene, config, street, frame);
        EXPECT_LT(after, 0.9 * before);
        street.lidars[std::size_t(frame.lidar)].vehicle_from_sensor.translation.y += 3.0;
        EXPECT_GT(measure_held_out_error(device(), result.scene, config, street, frame), 1.2 * after);
        street.lidars[std::size_t(frame.lidar)].vehicle_from_sensor.translation.y -= 3.0;
    }
}

}  // namespace
}  // namespace relidar
