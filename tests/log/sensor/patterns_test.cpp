// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor.hpp>

#include <cmath>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

namespace relidar {
namespace {

const RosetteSensor kRosette{.name = "r",
                             .deflection_rad = 0.15,
                             .first_hz = 110.0,
                             .second_hz = -70.0,
                             .n_rays = 5000,
                             .period_s = 0.1};

/// The sum of two equal rotating deflections has the length 2 |cos| of half their angle,
/// and their mean direction.
TEST(Patterns, RosetteIsTheSumOfTwoTurningDeflections) {
    const double time_s = 12.34;
    const RayTable rays = make_rays(kRosette, time_s);
    double widest = 0.0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const double t = time_s + ((double(i) + 0.5) / 5000.0 - 0.5) * 0.1;
        const double half_difference = kPi * (110.0 + 70.0) * t, mean = kPi * (110.0 - 70.0) * t;
        const double bent = 2.0 * 0.15 * std::cos(half_difference);
        const glm::dvec3 expected(std::cos(bent), std::sin(bent) * std::cos(mean),
                                  std::sin(bent) * std::sin(mean));
        ASSERT_LT(glm::length(glm::dvec3(rays.direction[i]) - expected), 1e-6) << i;
        ASSERT_NEAR(rays.time_offset_s[i], t - time_s, 1e-7);
        widest = std::max(widest, std::acos(double(rays.direction[i].x)));
    }
    EXPECT_NEAR(widest, 0.3, 1e-3) << "petals reach twice the deflection";
}

TEST(Patterns, RosettesOfTwoScansDiffer) {
    EXPECT_NE(make_rays(kRosette, 0.0).direction, make_rays(kRosette, 0.0333).direction);
    EXPECT_EQ(make_rays(kRosette, 0.5).direction, make_rays(kRosette, 0.5).direction);
}

TEST(Patterns, WindowsHaveTheirCornersAndTimes) {
    const WindowScanSensor window{.name = "w",
                                  .rows = 3,
                                  .columns = 5,
                                  .left_rad = 1.0,
                                  .right_rad = -0.5,
                                  .top_rad = 0.2,
                                  .bottom_rad = -0.4,
                                  .period_s = 0.05};
    const RayTable rays = make_rays(window);
    ASSERT_EQ(rays.size(), 15u);
    const auto expect = [&](std::size_t at, double azimuth, double elevation, double time_s) {
        EXPECT_NEAR(std::atan2(rays.direction[at].y, rays.direction[at].x), azimuth, 1e-6) << at;
        EXPECT_NEAR(std::asin(rays.direction[at].z), elevation, 1e-6) << at;
        EXPECT_NEAR(rays.time_offset_s[at], time_s, 1e-8) << at;
    };
    expect(0, 1.0, 0.2, -0.02);
    expect(4, -0.5, 0.2, 0.02);
    expect(7, 0.25, -0.1, 0.0);
    expect(14, -0.5, -0.4, 0.02);
    EXPECT_EQ(rays.channel[14], 2);
}

TEST(Patterns, SizesThatNoSensorHasAreRefused) {
    RosetteSensor many = kRosette;
    many.n_rays = 1 << 30;
    EXPECT_THROW(make_rays(many, 0.0), UsageError);
    EXPECT_THROW(make_rays(kRosette, std::nan("")), UsageError);
    EXPECT_THROW(make_rays(WindowScanSensor{.name = "w", .rows = 70'000, .columns = 1}), UsageError);
    EXPECT_THROW(make_rays(WindowScanSensor{.name = "w", .rows = 100'000, .columns = 100'000}), UsageError);
    EXPECT_THROW(make_rays(WindowScanSensor{.name = "w", .rows = 1, .columns = 1, .period_s = 0.0}),
                 UsageError);
}

}  // namespace
}  // namespace relidar
