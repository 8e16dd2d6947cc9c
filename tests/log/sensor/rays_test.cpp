// SPDX-License-Identifier: Apache-2.0
// Rays of spinning sensors, measurements of a beam, and range images (Eq. 6-7).
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/geometry/incidence.hpp"
#include "base/random.hpp"

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

/// Column c of 8 faces 157.5 - 45 c degrees. Clockwise from 60 to -60 degrees are the
/// columns at 22.5 and -22.5 degrees, from -60 to 60 all others.
TEST(Rays, FieldOfViewSelectsColumns) {
    const auto columns_between = [](double first_deg, double last_deg, bool clockwise = true) {
        SpinningSensor sensor = make_two_beams();
        sensor.clockwise = clockwise;
        sensor.azimuth_rad = {first_deg * kPi / 180.0, last_deg * kPi / 180.0};
        EXPECT_EQ(summarise_pattern(sensor).n_rays, 2 * fired_columns(sensor).size());
        return fired_columns(sensor);
    };
    EXPECT_EQ(columns_between(60, -60), (std::vector{3, 4}));
    EXPECT_EQ(columns_between(-60, 60), (std::vector{0, 1, 2, 5, 6, 7}));
    EXPECT_EQ(columns_between(60, -60, false), (std::vector{0, 1, 2, 5, 6, 7}));
    EXPECT_EQ(columns_between(22.5, -22.5), (std::vector{3, 4})) << "both ends are included";
    EXPECT_EQ(columns_between(180, -180).size(), 8u);
    SpinningSensor front = make_two_beams();
    front.azimuth_rad = {kPi / 3.0, -kPi / 3.0};
    const RayTable some = make_rays(front), all = make_rays(make_two_beams());
    ASSERT_EQ(std::pair(some.rows, some.columns), std::pair(2, 2));
    for (std::size_t i = 0; i < 4; ++i) {
        const std::size_t same = i / 2 * 8 + 3 + i % 2;
        EXPECT_EQ(some.direction[i], all.direction[same]);
        EXPECT_EQ(some.time_offset_s[i], all.time_offset_s[same]);
        EXPECT_EQ(some.channel[i], all.channel[same]);
    }
    front.azimuth_rad = {0.1, -0.1};
    EXPECT_THROW((void)make_rays(front), UsageError) << "no column";
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

TEST(Beam, MeasuringAndItsInverseArePairs) {
    Random random(11);
    for (int i = 0; i < 1000; ++i) {
        const Beam beam{.intensity_gain = 0.5 + random.sample_uniform(),
                        .intensity_offset = 0.1 * random.sample_uniform(),
                        .range_offset_m = 0.2 * random.sample_uniform() - 0.1};
        const double range = 1.0 + 80.0 * random.sample_uniform(), fall = 0.3 + 0.5 * random.sample_uniform(),
                     albedo = 0.6 * random.sample_uniform();
        EXPECT_NEAR(beam.to_surface_range_m(beam.to_measured_range_m(range)), range, 1e-12);
        EXPECT_NEAR(beam.to_measured_range_m(beam.to_surface_range_m(range)), range, 1e-12);
        EXPECT_NEAR(beam.to_surface_intensity(beam.to_measured_intensity(albedo, fall), fall), albedo, 1e-12);
    }
}

TEST(Beam, CutsWhatItCannotMeasure) {
    const Beam beam{.intensity_gain = 2.0, .intensity_offset = -0.1, .range_offset_m = -0.5};
    EXPECT_EQ(beam.to_measured_intensity(0.9, 1.0), 1.0);
    EXPECT_EQ(beam.to_measured_intensity(0.01, 1.0), 0.0);
    EXPECT_NEAR(beam.to_measured_intensity(0.3, 0.5), 2.0 * 0.5 * 0.3 - 0.1, 1e-15);
    EXPECT_EQ(beam.to_measured_range_m(0.2), 0.0);
    EXPECT_EQ(beam.to_measured_range_m(0.0), 0.0) << "nothing came back";
    EXPECT_EQ(beam.to_surface_range_m(0.0), 0.0);
    EXPECT_EQ((Beam{.range_offset_m = 3.0}.to_surface_range_m(1.0)), 1e-3);
}

TEST(HeadAzimuth, IsTheHeadThatFired) {
    Random random(12);
    for (int i = 0; i < 1000; ++i) {
        const Beam beam{.elevation_rad = random.sample_uniform() - 0.5,
                        .azimuth_offset_rad = 0.4 * random.sample_uniform() - 0.2,
                        .origin_offset_m = 0.1 * random.sample_uniform(),
                        .origin_up_m = 0.3 * random.sample_uniform(),
                        .origin_left_m = 0.1 * random.sample_uniform() - 0.05};
        const double head = 2.0 * kPi * (random.sample_uniform() - 0.5),
                     range = 1.0 + 60.0 * random.sample_uniform();
        const BeamRay ray = aim_beam(beam, head);
        EXPECT_NEAR(
            std::remainder(azimuth_facing_rad(beam, ray.origin_m + range * ray.direction) - head, 2.0 * kPi),
            0.0, 1e-12);
    }
}

TEST(RangeGrid, EveryPixelRayProjectsToItsOwnPixel) {
    const RangeImageGrid grid = kitti360_grid();
    const RayTable rays = make_rays(grid);
    ASSERT_EQ(rays.rows, 66);
    ASSERT_EQ(rays.columns, 1030);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto pixel = project_to_pixel(grid, 17.0 * glm::dvec3(rays.direction[i]));
        ASSERT_TRUE(pixel) << i;
        ASSERT_EQ(*pixel, int(i));
    }
}

TEST(RangeGrid, BinsAreCentredOnTheRays) {
    const RangeImageGrid grid = kitti360_grid();
    const auto point = [](double row, double column) {
        const double el = (2.0 - row * 26.9 / 66) * kPi / 180,
                     az = (180.0 - column * 360.0 / 1030) * kPi / 180;
        return 10.0 * glm::dvec3(std::cos(el) * std::cos(az), std::cos(el) * std::sin(az), std::sin(el));
    };
    EXPECT_EQ(project_to_pixel(grid, point(3.49, 7.49)), 3 * 1030 + 7);
    EXPECT_EQ(project_to_pixel(grid, point(3.51, 7.51)), 4 * 1030 + 8);
    EXPECT_EQ(project_to_pixel(grid, point(0.0, 1029.6)), 0);  // the column wraps
    EXPECT_EQ(project_to_pixel(grid, point(-0.51, 5)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, point(65.51, 5)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, glm::dvec3(0.0)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, 8.01 * point(3, 3)), std::nullopt);  // a range of 80.1 m
}

TEST(RangeGrid, NearestPointWinsAPixel) {
    const RangeImageGrid grid = kitti360_grid();
    const ProjectedRangeImage image =
        project_points(grid, {{20, 0, 0}, {10, 0, 0}, {15, 0, 0}, {0, 0, 5}}, {0.1f, 0.2f, 0.3f, 0.4f});
    const auto at = std::size_t(*project_to_pixel(grid, {10, 0, 0}));
    EXPECT_EQ(image.source[at], 1);
    EXPECT_FLOAT_EQ(image.range_m[at], 10.0f);
    EXPECT_FLOAT_EQ(image.intensity[at], 0.2f);
    EXPECT_EQ(std::count_if(image.source.begin(), image.source.end(), [](int s) { return s >= 0; }), 1);
    EXPECT_THROW(project_points(grid, {{1, 0, 0}}, {}), UsageError);
    EXPECT_THROW(find_grid("kiti360"), UsageError);
}

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
