// SPDX-License-Identifier: Apache-2.0
// Tests wet roads: level ground of constant brightness and a wall whose mirror image has
// an exact position.

#include <gtest/gtest.h>

#include "../../support/device.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

class WetGroundOnScans : public test::DeviceTest {};

/// Dark ground half a metre below the sensor, and a wall of intensity 0.5, 12 m ahead.
Surfels make_ground_before_wall() {
    Surfels scene = test::make_plate({12.0f, 0.0f, -0.5f}, glm::vec2(3.0f));
    Surfels disc = test::make_plate({}, glm::vec2(0.5f), true);
    disc.sh[0] = -1.4f;
    for (int x = -20; x < 12; ++x) {
        for (int y = -12; y <= 12; ++y) {
            disc.mean[0] = {float(x), float(y), -0.5f};
            scene.append_surfels(disc);
        }
    }
    return scene;
}

/// Eight beams that point down by 3.6 to 5.7 degrees.
Log make_sequence_looking_down() {
    std::vector<double> elevations_rad;
    for (int beam = 0; beam < 8; ++beam) elevations_rad.push_back(-kPi / 180.0 * (3.6 + 0.3 * beam));
    return test::make_static_log(elevations_rad, 360);
}

/// The point lies on the mirror image of the wall below the ground, if that is brighter
/// than the ground, which water darkens.
TEST_F(WetGroundOnScans, IsDarkerAndMirrorsAWall) {
    const Config config;
    const Log log = make_sequence_looking_down();
    ScanRenderer renderer(device(), wrap_background(make_ground_before_wall()), config, log);
    const SimulatedSensor sensor = make_sensor(config, log);
    const RenderedScan dry = renderer.render(sensor, 0.0);
    renderer.set_weather({.wet_mm = 2.0});
    const RenderedScan wet = renderer.render(sensor, 0.0);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(wet.channels, "source");
    int mirrored = 0, darker = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        const glm::vec3 d = wet.image.direction[i];
        const double ground_m = 0.5 / -double(d.z), wall_m = 12.0 / double(d.x);
        if (dry.median_range_m[i] == 0.0f || ground_m > 11.0) continue;
        ASSERT_NEAR(dry.median_range_m[i], ground_m, 0.02);
        if (source[i] == std::int32_t(ReturnCause::mirror)) {
            ++mirrored;
            ASSERT_GT(d.x, 0.0f);
            ASSERT_NEAR(wet.median_range_m[i], wall_m, 0.2) << "the tracing begins 0.1 m above the ground";
            ASSERT_EQ(wet.instance[i], -1);
            const double up_m = (wall_m - ground_m) * -double(d.z), left_m = wall_m * double(d.y);
            const double wall =
                0.5 / (1.0 + std::exp(-6.0)) * std::exp(-0.5 * (up_m * up_m + left_m * left_m) / 9.0);
            ASSERT_NEAR(wet.image.intensity[i], wall * std::pow(water_reflectance(-double(d.z)), 2), 0.02);
        } else if (source[i] == std::int32_t(ReturnCause::surface)) {
            ++darker;
            ASSERT_EQ(wet.median_range_m[i], dry.median_range_m[i]);
            ASSERT_NEAR(wet.image.intensity[i] / dry.image.intensity[i],
                        wet_ratio(-double(d.z), double(dry.image.intensity[i])),
                        // close to the foot of the wall, the tolerance is larger, because
                        // the estimated ground is tilted
                        ground_m * double(d.x) < 6.0 ? 1e-3 : 0.05)
                << i;
        }
    }
    EXPECT_GT(mirrored, 20);
    EXPECT_GT(darker, 1000);
    renderer.set_weather({});
    EXPECT_EQ(renderer.render(sensor, 0.0).image.intensity, dry.image.intensity);
}

/// The range to the mirror image falls by the speed of the sensor along the ray.
TEST_F(WetGroundOnScans, MirrorImagesHaveTheVelocityOfTheirObjects) {
    Config config;
    config.render.channels = "velocity";
    Log log = make_sequence_looking_down();
    log.world_from_vehicle = {{-1.0, 1.0},
                              {Pose{{1, 0, 0, 0}, {-8.0, 0.0, 0.0}}, Pose{{1, 0, 0, 0}, {8.0, 0.0, 0.0}}}};
    ScanRenderer renderer(device(), wrap_background(make_ground_before_wall()), config, log);
    renderer.set_weather({.wet_mm = 2.0});
    const RenderedScan wet = renderer.render(make_sensor(config, log), 0.0);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(wet.channels, "source");
    int mirrored = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        if (source[i] != std::int32_t(ReturnCause::mirror)) continue;
        ++mirrored;
        ASSERT_NEAR(find_values<float>(wet.channels, "velocity")->at(i),
                    -8.0 * double(wet.image.direction[i].x), 1e-3);
    }
    EXPECT_GT(mirrored, 20);
}

}  // namespace
}  // namespace relidar
