// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor.hpp>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/geometry/incidence.hpp"

namespace relidar {
namespace {

SpinningSensor make_two_beams() {
    SpinningSensor sensor;
    sensor.name = "two";
    sensor.beams = {{.elevation_rad = 0.1}, {.elevation_rad = -0.3}};
    sensor.columns = 8;
    sensor.first_azimuth_rad = kPi - kPi / 8;
    return sensor;
}

double azimuth(const glm::vec3& direction) { return std::atan2(direction.y, direction.x); }

TEST(Rays, ColumnsFallFromFirstAzimuthAndTimesFollowTheHead) {
    const RayTable rays = make_rays(make_two_beams());
    ASSERT_EQ(rays.size(), 16u);
    for (int c = 0; c < 8; ++c) {
        const double az = kPi - kPi / 8 - c * kPi / 4;
        EXPECT_NEAR(azimuth(rays.direction[c]), az, 1e-6);
        EXPECT_NEAR(rays.direction[8 + c].z, std::sin(-0.3), 1e-6);
        EXPECT_NEAR(rays.time_offset_s[c], -az / (2 * kPi) * 0.1, 1e-8);
        EXPECT_EQ(rays.channel[8 + c], 1);
    }
    SpinningSensor other = make_two_beams();
    other.clockwise = false;
    EXPECT_NEAR(make_rays(other).time_offset_s[0], -rays.time_offset_s[0], 1e-9);
}

/// Columns of a window end, even if the window is narrower than the allowed gap.
TEST(Rays, OnlyAFullTurnIsCircular) {
    const auto is_circular = [](const RayTable& rays) {
        return is_full_turn(rays.rows, rays.columns, rays.direction);
    };
    EXPECT_TRUE(is_circular(make_rays(make_two_beams())));
    for (const auto& [left_rad, right_rad] : {std::pair(0.25 * kPi, -0.25 * kPi), {0.1, 0.0}, {4.0, 2.0}})
        EXPECT_FALSE(is_circular(make_rays(WindowScanSensor{"", 4, 20, left_rad, right_rad, 0.1, -0.1})));
    EXPECT_TRUE(is_circular(make_rays(WindowScanSensor{"", 4, 20, kPi, -0.9 * kPi, 0.1, -0.1})));
}

/// A wall at x = 5 in front of a window of 90 degrees. The neighbours of the outer four
/// columns are missing on one side, although all ranges are similar.
TEST(Rays, IncidenceEndsWithTheWindow) {
    const RayTable rays = make_rays(WindowScanSensor{"", 3, 91, 0.25 * kPi, -0.25 * kPi, 0.02, -0.02});
    std::vector<float> range_m;
    for (const glm::vec3& direction : rays.direction) range_m.push_back(5.0f / direction.x);
    const RangeImageRays image{rays.rows, rays.columns, rays.origin, rays.direction, range_m, false};
    for (std::size_t c = 0; c < 91; ++c)
        EXPECT_NEAR(incidence_cosine(image, 91 + c),
                    c < 4 || c > 86 ? -1.0 : double(rays.direction[91 + c].x), 1e-5)
            << c;
}

TEST(Rays, OusterOriginsLieAlongTheHeadNotTheBeam) {
    // At theta = 0 the origin is (n, 0, 0), and the direction is at the azimuth offset
    // (Ouster's xyz formula with r = n).
    const BeamRay ray =
        aim_beam({.elevation_rad = 0.2, .azimuth_offset_rad = 0.05, .origin_offset_m = 0.015}, 0.0);
    EXPECT_NEAR(glm::length(ray.origin_m - glm::dvec3(0.015, 0, 0)), 0.0, 1e-12);
    EXPECT_NEAR(std::atan2(ray.direction.y, ray.direction.x), 0.05, 1e-12);
}

TEST(Rays, LiftedBeamsCrossTheAxisAtUpOverCosine) {
    const double el = -0.2, up = 0.12;
    for (const double head : {0.0, 1.0, -2.5}) {
        const BeamRay ray =
            aim_beam({.elevation_rad = el, .azimuth_offset_rad = 0.1, .origin_up_m = up}, head);
        const double t = -(ray.origin_m.x * ray.direction.x + ray.origin_m.y * ray.direction.y) /
                         std::pow(std::cos(el), 2);
        const glm::dvec3 p = ray.origin_m + t * ray.direction;
        EXPECT_NEAR(std::hypot(p.x, p.y), 0.0, 1e-12);
        EXPECT_NEAR(p.z, up / std::cos(el), 1e-12);
        EXPECT_NEAR(glm::dot(ray.origin_m, ray.direction), 0.0, 1e-12);
        EXPECT_NEAR(glm::length(ray.origin_m), up, 1e-12);
    }
    const BeamRay left = aim_beam({.azimuth_offset_rad = kPi / 2, .origin_left_m = 0.03}, 0.0);
    EXPECT_NEAR(left.origin_m.x, -0.03, 1e-12);  // the beam points along +y, so its left is -x
}

TEST(Rays, OffsetBeamsAreMovedByWholeColumns) {
    SpinningSensor sensor = make_two_beams();
    sensor.columns = 360;
    sensor.first_azimuth_rad = kPi - kPi / 360;
    sensor.beams[1].azimuth_offset_rad = 7.3 * kPi / 180;
    const RayTable rays = make_rays(sensor);
    for (int c = 0; c < 360; ++c) {
        const double difference = azimuth(rays.direction[360 + c]) - azimuth(rays.direction[c]);
        EXPECT_NEAR(std::remainder(difference, 2 * kPi), 0.3 * kPi / 180, 1e-5);
        const double head = azimuth(rays.direction[360 + c]) - 7.3 * kPi / 180;
        EXPECT_NEAR(rays.time_offset_s[360 + c], -std::remainder(head, 2 * kPi) / (2 * kPi) * 0.1, 1e-7);
    }
}

TEST(Rays, ImpossibleSensorsAreRefused) {
    SpinningSensor no_beams = make_two_beams(), no_columns = no_beams, no_number = no_beams;
    no_beams.beams.clear();
    no_columns.columns = 0;
    no_number.beams[1].origin_up_m = std::numeric_limits<double>::quiet_NaN();
    for (const SpinningSensor& sensor : {no_beams, no_columns, no_number})
        EXPECT_THROW(make_rays(sensor), UsageError);
}

}  // namespace
}  // namespace relidar
