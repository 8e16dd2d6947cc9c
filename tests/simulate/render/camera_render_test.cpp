// SPDX-License-Identifier: Apache-2.0
// Tests pictures of a camera in front of walls at exact positions.

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/camera.hpp>

#include "../../support/device.hpp"
#include "../../support/drop_networks.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

class CameraRender : public test::DeviceTest {};

/// 0.5 m to the left of the LiDAR, turned by 30 degrees to the right.
Camera make_turned_camera() {
    Camera camera = parse_camera(
        R"({"K": [40, 0, 19.5, 0, 50, 14.5, 0, 0, 1], "size": [40, 30], "translation_m": [0, 0.5, 0],
            "yaw_pitch_roll_deg": [-30, 0, 0]})",
        "test");
    return camera;
}

/// The wall is the plane x = 10 m. Its returns have intensity 0.5. The LiDAR measures
/// another intensity, and its network would drop every ray.
TEST_F(CameraRender, AWallHasItsExactDepthAndBrightness) {
    Log log = test::make_static_log({0.1, -0.1}, 360);
    log.rolling_shutter = true;
    for (Beam& beam : log.lidars[0].sensor.beams) beam.intensity_gain = 0.2, beam.range_offset_m = 0.3;
    log.intensity_response = {{5.0, 20.0}, {0.5, 0.1}};
    Config config;
    config.sensor.sub_rays = 5;
    config.sensor.returns = 2;
    ScanRenderer renderer(device(), wrap_background(test::make_plate({10.0f, 0.0f, 0.0f}, glm::vec2(50.0f))),
                          config, log);
    RayDropNetwork network = test::make_network_that_never_drops();
    network.parameters[*network::UnetLayout(network).last_conv.bias] = 40.0f;
    renderer.use_network(network);
    const Camera camera = make_turned_camera();
    const SimulatedSensor sensor = camera_sensor(camera, config, log);
    EXPECT_FALSE(renderer.has_network_for(sensor));
    const RenderedScan scan = renderer.render(sensor, 0.0, camera.rig_from_camera);
    const DepthImage depth = draw_depth(scan);
    const Image picture = draw_camera(scan);
    ASSERT_EQ(depth.values.size(), 40u * 30u);
    ASSERT_EQ(picture.rgb.size(), 3u * 40u * 30u);
    for (int row = 0; row < 30; ++row)
        for (int column = 0; column < 40; ++column) {
            const std::size_t i = std::size_t(40 * row + column);
            const glm::dvec3 direction = camera.direction_of({column, row});
            const double range_m = 10.0 / (camera.rig_from_camera.rotation * direction).x;
            EXPECT_NEAR(double(scan.median_range_m[i]), range_m, 1e-4 * range_m) << row << ' ' << column;
            EXPECT_NEAR(depth.values[i], 256.0 * range_m * direction.z, 0.51 + 1e-4 * 256.0 * range_m);
            EXPECT_NEAR(picture.rgb[3 * i], 255.0 * 0.5 * double(scan.weight[i]), 0.6);
            EXPECT_EQ(picture.rgb[3 * i], picture.rgb[3 * i + 2]);
            EXPECT_EQ(scan.ring[i], row);
            EXPECT_EQ(scan.time_offset_s[i], 0.0f);
        }
    EXPECT_THROW(renderer.render(sensor, 0.0, {}, SampleSeed(1)), UsageError);
    renderer.set_weather(parse_weather("rain=10"));
    EXPECT_THROW(renderer.render(sensor, 0.0), UsageError);
}

TEST_F(CameraRender, TheSkyIsBlackAndHasNoDepth) {
    const Log log = test::make_static_log({0.0}, 4);
    const Config config;
    ScanRenderer renderer(device(),
                          wrap_background(test::make_plate({0.0f, 0.0f, -2.0f}, glm::vec2(20.0f), true)),
                          config, log);
    const Camera camera =
        parse_camera(R"({"K": [20, 0, 9.5, 0, 20, 9.5, 0, 0, 1], "size": [20, 20]})", "test");
    const RenderedScan scan =
        renderer.render(camera_sensor(camera, config, log), 0.0, camera.rig_from_camera);
    for (std::size_t i = 0; i < 200; ++i) {
        EXPECT_EQ(draw_depth(scan).values[i], 0) << i;
        EXPECT_EQ(draw_camera(scan).rgb[3 * i], 0) << i;
    }
    // The lowest row looks 25 degrees down.
    EXPECT_NEAR(draw_depth(scan).values[390], 256.0 * 2.0 / (9.5 / 20.0), 1.0);
    EXPECT_GT(draw_camera(scan).rgb[3 * 390], 100);
}

TEST(CameraPicture, DepthThatDoesNotFitIsNoDepth) {
    RenderedScan scan;
    scan.image.range_m = {255.99f, 256.0f, 100.0f};
    scan.image.direction = {{0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}, {0.6f, 0.0f, 0.8f}};
    EXPECT_THAT(draw_depth(test::complete(scan)).values, testing::ElementsAre(65533, 0, 20480));
}

}  // namespace
}  // namespace relidar
