// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/clouds.hpp>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include "base/random.hpp"

namespace relidar {
namespace {

constexpr int kBeams = 32, kColumns = 900;

/// Beams are 0.4 to 1.2 degrees apart, staggered by less than half a column.
SpinningSensor make_true_sensor(bool clockwise = true) {
    SpinningSensor s;
    double elevation_deg = 15.0;
    for (int b = 0; b < kBeams; ++b) {
        s.beams.push_back(
            {.elevation_rad = elevation_deg * kPi / 180.0, .azimuth_offset_rad = 0.002 * (b % 3 - 1)});
        elevation_deg -= 0.4 + 0.4 * (b % 3);
    }
    s.columns = kColumns;
    s.period_s = 0.05;
    s.clockwise = clockwise;
    s.first_azimuth_rad = kPi - kPi / kColumns;
    return s;
}

/// Four of five rays have points at 3 to 70 m (3 to 8 m for beams that look down). Rings
/// are counted from the lowest beam.
LidarPoints make_points_on(const SpinningSensor& sensor, std::uint64_t seed) {
    Random random(seed);
    const RayTable rays = make_rays(sensor);
    LidarPoints points;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        if (random.sample_uniform() < 0.2) continue;
        points.position_m.push_back(rays.origin[i] +
                                    float(random.sample_uniform(3.0, rays.channel[i] < 20 ? 70.0 : 8.0)) *
                                        rays.direction[i]);
        points.intensity.push_back(0.5f);
        points.ring.push_back(std::uint16_t(sensor.beams.size() - 1 - rays.channel[i]));
        points.time_offset_s.push_back(rays.time_offset_s[i]);
    }
    return points;
}

void expect_beams(const std::vector<Beam>& beams, const std::vector<Beam>& truth, double tolerance) {
    ASSERT_EQ(beams.size(), truth.size());
    for (std::size_t b = 0; b < truth.size(); ++b)
        EXPECT_NEAR(beams[b].elevation_rad, truth[b].elevation_rad, tolerance) << "beam " << b;
}

TEST(FindBeams, FromElevationsAlone) {
    const SpinningSensor truth = make_true_sensor();
    expect_beams(estimate_beams({make_points_on(truth, 1), make_points_on(truth, 2)}), truth.beams, 1e-5);
}

TEST(FindBeams, NoneWhereElevationsDoNotGather) {
    Random random(3);
    LidarPoints points;
    for (int i = 0; i < 20000; ++i)
        points.position_m.emplace_back(random.sample_uniform(5.0, 50.0), random.sample_uniform(-10.0, 10.0),
                                       random.sample_uniform(-3.0, 3.0));
    EXPECT_TRUE(estimate_beams({points}).empty());
    EXPECT_TRUE(estimate_beams({}).empty());
    SpinningSensor wide = make_true_sensor();
    // Viewed from the centre, the elevation range of each beam is wider than the beam
    // spacing.
    for (Beam& beam : wide.beams) beam.origin_up_m = 1.0;
    EXPECT_TRUE(estimate_beams({make_points_on(wide, 1)}).empty());
}

// Beams with few returns must be kept. In a scan from TIER IV's nebula, the lowest four
// beams of a QT128 with returns have 1 to 4 points.
TEST(FindBeams, KeepsBeamsWithFewReturns) {
    SpinningSensor truth = std::get<SpinningSensor>(find_built_in("QT128", 900, 10.0)->pattern);
    for (Beam& beam : truth.beams) beam = {.elevation_rad = beam.elevation_rad};
    const RayTable rays = make_rays(truth);
    Random random(11);
    std::vector<int> n_left(128, 1004);
    n_left[0] = 2;
    n_left[60] = 3;
    n_left[125] = 2;
    n_left[126] = 1;
    n_left[127] = 4;
    LidarPoints points;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (const int n = n_left[rays.channel[i]]--; n > 0)
            points.position_m.push_back(float(n < 5 ? 19.0 : random.sample_uniform(2.0, 20.0)) *
                                        rays.direction[i]);
    expect_beams(estimate_beams({points}), truth.beams, 1e-5);
    for (const double elevation_deg : {-53.1, -54.2, 53.0, 0.31, 7.7}) {  // stray points between the beams
        const double e = elevation_deg * kPi / 180.0;
        points.position_m.emplace_back(10.0 * std::cos(e), 0.0, 10.0 * std::sin(e));
    }
    expect_beams(estimate_beams({points}), truth.beams, 1e-5);
}

TEST(RecoverRings, OfBeamsThatStartBesideTheCentre) {
    SpinningSensor s = make_true_sensor();
    // 2 degrees at 3 m, which is three beam spacings
    for (Beam& beam : s.beams) {
        beam.origin_offset_m = 0.03;
        beam.origin_up_m = 0.15;
    }
    LidarPoints points = make_points_on(s, 4);
    std::vector<std::uint16_t> truth;
    for (const std::uint16_t ring : points.ring) truth.push_back(std::uint16_t(kBeams - 1 - ring));
    assign_rings(points, s.beams);
    EXPECT_EQ(points.ring, truth);
    EXPECT_THROW(assign_rings(points, {}), UsageError);
}

TEST(FitSensor, BeamsColumnsAndTurning) {
    for (const bool clockwise : {true, false}) {
        const SpinningSensor truth = make_true_sensor(clockwise);
        const FittedSensor fit =
            fit_spinning_sensor({make_points_on(truth, 5), make_points_on(truth, 6)}, 0.1);
        expect_beams(fit.sensor.beams, truth.beams, 1e-5);
        EXPECT_EQ(fit.sensor.columns, kColumns);
        EXPECT_EQ(fit.sensor.clockwise, clockwise);
        EXPECT_NEAR(fit.sensor.period_s, 0.05, 1e-4);
        ASSERT_EQ(fit.beam_of_ring.size(), std::size_t(kBeams));
        for (int ring = 0; ring < kBeams; ++ring)
            EXPECT_EQ(fit.beam_of_ring[std::size_t(ring)], kBeams - 1 - ring);
        // the absolute azimuth of the sensor head is unknown
        for (std::size_t b = 1; b < truth.beams.size(); ++b)
            EXPECT_NEAR(fit.sensor.beams[b].azimuth_offset_rad - fit.sensor.beams[0].azimuth_offset_rad,
                        truth.beams[b].azimuth_offset_rad - truth.beams[0].azimuth_offset_rad, 1e-5);
    }
}

TEST(FitSensor, WithoutTimesTakesThePeriodThatIsGiven) {
    LidarPoints points = make_points_on(make_true_sensor(false), 5);
    points.time_offset_s.clear();
    const FittedSensor fit = fit_spinning_sensor({points}, 0.1);
    EXPECT_EQ(fit.sensor.period_s, 0.1);
    EXPECT_TRUE(fit.sensor.clockwise);
}

TEST(FitSensor, KeepsRingsWithoutPointsOut) {
    LidarPoints points = make_points_on(make_true_sensor(), 5);
    for (std::uint16_t& ring : points.ring) ring = std::uint16_t(ring + (ring >= 10));
    const FittedSensor fit = fit_spinning_sensor({points}, 0.1);
    EXPECT_EQ(fit.sensor.beams.size(), std::size_t(kBeams));
    EXPECT_EQ(fit.beam_of_ring[10], kNoBeam);
    EXPECT_EQ(fit.beam_of_ring[11], kBeams - 1 - 10);
}

TEST(FitSensor, WhatItCannotFit) {
    LidarPoints points = make_points_on(make_true_sensor(), 5);
    points.ring.clear();
    EXPECT_THROW(fit_spinning_sensor({points}, 0.1), UsageError);
    EXPECT_THROW(fit_spinning_sensor({}, 0.1), UsageError);
    const LidarPoints one{.position_m = {{5.0f, 0.0f, 0.0f}},
                          .intensity = {0.5f},
                          .ring = {0},
                          .time_offset_s = {},
                          .return_number = {},
                          .firing = {}};
    EXPECT_THROW(fit_spinning_sensor({one}, 0.1), DataError);
}

}  // namespace
}  // namespace relidar
