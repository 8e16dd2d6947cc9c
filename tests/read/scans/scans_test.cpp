// SPDX-License-Identifier: Apache-2.0
// Points are computed from the rays of a sensor. Each must return to its ray, and fitted
// sensors must equal the sensor.
#include <relidar/log/calibration.hpp>
#include <relidar/read/clouds.hpp>

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/score/metrics.hpp>
#include "base/random.hpp"
#include "support/names.hpp"
#include "support/two_lidars.hpp"

namespace relidar {
namespace {

SpinningSensor sensor() {
    SpinningSensor s;
    for (int b = 0; b < 12; ++b)
        s.beams.push_back({.elevation_rad = 0.05 - 0.03 * b,
                           .azimuth_offset_rad = 0.02 * (b % 3 - 1),
                           .origin_offset_m = 0.03,
                           .origin_up_m = 0.1,
                           .origin_left_m = 0.02 * (b % 2)});
    s.columns = 360;
    s.period_s = 0.1;
    s.first_azimuth_rad = kPi - 0.3 * 2.0 * kPi / 360;  // an arbitrary phase
    return s;
}

/// Every fifth ray has no return, and some rays have a second return.
struct Truth {
    Scan scan;
    LidarPoints points;  ///< shuffled

    explicit Truth(const SpinningSensor& sensor, bool second = false) {
        Random random(5);
        scan.rays = make_rays(sensor);
        scan.range_m.assign(scan.rays.size(), 0.0f);
        scan.intensity.assign(scan.rays.size(), 0.0f);
        if (second) scan.second_returns.assign(1, {to_vector(scan.range_m), to_vector(scan.intensity)});
        for (std::size_t i = 0; i < scan.rays.size(); ++i) {
            if (random.sample_uniform() < 0.2) continue;
            scan.range_m[i] = float(random.sample_uniform(2.0, 60.0));
            scan.intensity[i] = float(random.sample_uniform());
            if (second && random.sample_uniform() < 0.1) {
                scan.second_returns[0].range_m[i] = scan.range_m[i] + 3.0f;
                scan.second_returns[0].intensity[i] = 0.25f;
            }
        }
        std::vector<std::size_t> order(scan.rays.size());
        std::iota(order.begin(), order.end(), std::size_t(0));
        for (std::size_t i = order.size(); i-- > 1;)
            std::swap(order[i], order[std::size_t(random.next_uint64() % (i + 1))]);
        for (const std::size_t i : order) {
            if (scan.range_m[i] == 0.0f) continue;
            add(i, scan.range_m[i], scan.intensity[i], 1);
            if (second && scan.second_returns[0].range_m[i] > 0.0f)
                add(i, scan.second_returns[0].range_m[i], scan.second_returns[0].intensity[i], 2);
        }
    }

private:
    void add(std::size_t ray, float range_m, float intensity, std::uint8_t number) {
        points.position_m.push_back(scan.rays.origin[ray] + range_m * scan.rays.direction[ray]);
        points.intensity.push_back(intensity);
        points.ring.push_back(scan.rays.channel[ray]);
        points.return_number.push_back(number);
        // the sensor faces forward 4 ms late
        points.time_offset_s.push_back(scan.rays.time_offset_s[ray] + 0.004f);
    }
};

void expect_same_rays(const Scan& actual, const Scan& truth, float late_s) {
    ASSERT_EQ(actual.rays.rows, truth.rays.rows);
    ASSERT_EQ(actual.rays.columns, truth.rays.columns);
    for (std::size_t i = 0; i < truth.rays.size(); ++i) {
        ASSERT_EQ(actual.range_m[i] > 0.0f, truth.range_m[i] > 0.0f) << "ray " << i;
        EXPECT_NEAR(actual.range_m[i], truth.range_m[i], 1e-4f);
        EXPECT_EQ(actual.intensity[i], truth.intensity[i]);
        EXPECT_LT(glm::distance(actual.rays.direction[i], truth.rays.direction[i]), 1e-4f) << "ray " << i;
        EXPECT_LT(glm::distance(actual.rays.origin[i], truth.rays.origin[i]), 1e-4f);
        EXPECT_EQ(actual.rays.channel[i], truth.rays.channel[i]);
        EXPECT_NEAR(actual.rays.time_offset_s[i], truth.rays.time_offset_s[i] + late_s, 1e-5f) << "ray " << i;
    }
}

Scan assign(const LidarPoints& points, const SpinningSensor& sensor) {
    return spinning_scan(points, sensor, fit_even_sweep(points, sensor));
}

TEST(SpinningScan, PointsFindTheirRaysAndTheRestIsDropped) {
    for (const bool clockwise : {true, false}) {
        SpinningSensor spinning = sensor();
        spinning.clockwise = clockwise;
        Truth truth(spinning);
        expect_same_rays(assign(truth.points, spinning), truth.scan, 0.004f);  // times of the points
        truth.points.time_offset_s.clear();
        expect_same_rays(assign(truth.points, spinning), truth.scan, 0.0f);
    }
}

TEST(SpinningScan, KeepsSecondReturns) {
    const Truth truth(sensor(), true);
    const Scan actual = assign(truth.points, sensor());
    ASSERT_EQ(actual.second_returns.size(), 1u);
    for (std::size_t i = 0; i < truth.scan.rays.size(); ++i) {
        EXPECT_NEAR(actual.range_m[i], truth.scan.range_m[i], 1e-4f);
        EXPECT_NEAR(actual.second_returns[0].range_m[i], truth.scan.second_returns[0].range_m[i], 1e-4f);
        EXPECT_EQ(actual.second_returns[0].intensity[i], truth.scan.second_returns[0].intensity[i]);
    }
    Scan cut = actual;
    limit_ranges(cut, {0.0, 30.0});
    for (std::size_t i = 0; i < cut.range_m.size(); ++i)
        EXPECT_TRUE(cut.second_returns[0].range_m[i] == 0.0f ||
                    (cut.second_returns[0].range_m[i] <= 30.0f && cut.range_m[i] > 0.0f));
}

TEST(SpinningScan, FarPointsAreDroppedAndCrowdsThinned) {
    const SpinningSensor s = sensor();
    LidarPoints points;
    const BeamRay ray = aim_beam(s.beams[0], 0.0);
    for (const double range : {10.0, 12.0, 14.0, 11.0, 9.0, 200.0}) {
        points.position_m.emplace_back(ray.origin_m + range * ray.direction);
        points.intensity.push_back(2.0f);
        points.ring.push_back(0);
    }
    const Scan scan = assign(points, s);
    EXPECT_EQ(scan.count_returns(), 3u) << "its own ray and those beside it";
    EXPECT_NEAR(*std::max_element(scan.range_m.begin(), scan.range_m.end()), 14.0f, 1e-3f);
    EXPECT_EQ(std::count(scan.intensity.begin(), scan.intensity.end(), 1.0f), 3) << "intensities are cut";
    float nearest = 1e9f;
    for (const float range : scan.range_m) nearest = range > 0.0f ? std::min(nearest, range) : nearest;
    EXPECT_NEAR(nearest, 9.0f, 1e-3f) << "the nearer is kept";
}

/// In a sweep of more than a turn, two firings have azimuth 3.
TEST(SpinningScan, ToldFiringsOfOneAzimuthStayApart) {
    SpinningSensor one = sensor();
    one.beams = {{.elevation_rad = 0.0}};
    one.columns = 3;
    const EncoderTickGrid lattice{360, 0.0};
    const SweepFirings sweep{
        lattice, {lattice.nearest_tick(3.0), lattice.nearest_tick(3.0), lattice.nearest_tick(1.0)}};
    const auto point = [](double azimuth, float range_m) {
        return range_m * glm::vec3(std::cos(azimuth), std::sin(azimuth), 0.0);
    };
    const LidarPoints points{{point(1.0, 7.0f), point(3.0, 5.0f), point(3.0, 6.0f)},
                             {0.1f, 0.2f, 0.3f},
                             {0, 0, 0},
                             {0.05f, 0.0f, 0.1f},
                             {},
                             {2, 1, 0}};
    const Scan scan = spinning_scan(points, one, sweep);
    EXPECT_EQ(scan.rays.time_offset_s, (ScanArray<float>{0.1f, 0.0f, 0.05f}));
    for (std::size_t i = 0; i < 3; ++i)
        EXPECT_NEAR(scan.range_m[i], (std::array{6.0f, 5.0f, 7.0f}[i]), 1e-6f);
    LidarPoints beyond = points;
    beyond.firing[0] = 3;
    EXPECT_THROW(spinning_scan(beyond, one, sweep), UsageError);
}

TEST(UnorderedScan, HasARayForEachPointAndNoOther) {
    LidarPoints points;
    points.position_m = {{3, 4, 0}, {6, 8, 0}, {0, 0, -2}, {0, 0, 0}, {1, 0, 0}};
    points.intensity = {0.1f, 0.2f, 0.3f, 0.4f, -1.0f};
    points.time_offset_s = {0.0f, 0.0f, 0.01f, 0.02f, 0.03f};
    points.return_number = {1, 2, 1, 1, 1};
    const Scan scan = scan_of_points(points);
    EXPECT_EQ(scan.rays.rows, 1);
    EXPECT_EQ(scan.rays.columns, 3) << "a point in the sensor has no direction";
    EXPECT_EQ(scan.range_m, (ScanArray<float>{5, 2, 1}));
    EXPECT_EQ(scan.second_returns[0].range_m, (std::vector<float>{10, 0, 0}));
    EXPECT_EQ(scan.intensity, (ScanArray<float>{0.1f, 0.3f, 0.0f}));
    EXPECT_EQ(scan.rays.direction[1], glm::vec3(0, 0, -1));
    EXPECT_EQ(scan.rays.time_offset_s[2], 0.03f);
}

TEST(SpinningScan, SaysWhichArrayIsWrong) {
    LidarPoints points;
    const auto expect_error = [&](const std::string& parts) {
        EXPECT_THAT(
            [&] {
                spinning_scan(points, sensor(), {{360, 0.0}, {0}});
            },
            testing::ThrowsMessage<UsageError>(test::Names(parts)));
    };
    points.position_m = {{3, 4, 0}, {6, 8, 0}};
    points.intensity = {0.1f, 0.2f};
    expect_error("0 ... points ... 2");
    points.ring = {0, 12};
    expect_error("point 1 ... ring 12 ... 12");
    points.ring = {0, 11};
    points.return_number = {1, 200};
    expect_error("point 1 ... 200 ... 1 ... 8");
    points.return_number = {0, 1};
    expect_error("point 0 ... 0 ... 1 ... 8");
    points.return_number = {1};
    expect_error("1 ... return_number ... 2");
}

TEST(UndoCompensation, BringsPointsBackToTheirOwnTimes) {
    const PoseTrack track{{0.0, 1.0},
                          {Pose{}, Pose{glm::angleAxis(0.5, glm::dvec3(0, 0, 1)), {9.0, -2.0, 0.3}}}};
    Random random(9);
    LidarPoints points;
    std::vector<glm::vec3> measured;
    for (int i = 0; i < 200; ++i) {
        const double offset_s = random.sample_uniform(-0.05, 0.05);
        measured.emplace_back(random.sample_uniform(-30.0, 30.0), random.sample_uniform(-30.0, 30.0),
                              random.sample_uniform(-2.0, 3.0));
        points.time_offset_s.push_back(float(offset_s));
        const glm::dmat4 compensate = glm::inverse(to_matrix(track.pose_at(0.4))) *
                                      to_matrix(track.pose_at(0.4 + double(points.time_offset_s.back())));
        points.position_m.emplace_back(compensate * glm::dvec4(glm::dvec3(measured.back()), 1.0));
    }
    EXPECT_GT(glm::distance(points.position_m[0], measured[0]), 0.01f);
    undo_deskew(points, track, 0.4);
    for (std::size_t i = 0; i < measured.size(); ++i)
        EXPECT_LT(glm::distance(points.position_m[i], measured[i]), 2e-5f);
}

TEST(Tracks, LabelsJoinByIdAndTheWorldMovesAsOne) {
    Log log;
    for (int i = 0; i < 3; ++i) add_frame(log, i, 0.1 * i, {{1, 0, 0, 0}, {1000.0 + i, 5.0, 0.0}});
    log.boxes = build_tracks({{"b", "Car", {4, 2, 1.5}, 0.0, {{1, 0, 0, 0}, {1010, 5, 0}}},
                              {"a", "Van", {5, 2, 2}, 0.0, {}},
                              {"b", "Car", {4, 2, 1.5}, 0.1, {{1, 0, 0, 0}, {1011, 5, 0}}}});
    ASSERT_EQ(log.boxes.size(), 2u);
    EXPECT_EQ(log.boxes[0].id, "b");
    EXPECT_EQ(log.boxes[0].world_from_box.time_s, (std::vector<double>{0.0, 0.1}));
    add_frame(log, 2, 0.2, {{1, 0, 0, 0}, {77.0, 0.0, 0.0}}, 1);
    EXPECT_EQ(log.frames.size(), 4u);
    EXPECT_EQ(log.world_from_vehicle.pose.size(), 3u) << "the pose of that time is known";
    centre_log(log);
    EXPECT_EQ(log.world_offset_m, glm::dvec3(1001, 5, 0));
    EXPECT_EQ(log.world_from_vehicle.pose[2].translation, glm::dvec3(1, 0, 0));
    EXPECT_EQ(log.boxes[0].world_from_box.pose[1].translation, glm::dvec3(10, 0, 0));
}

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
    // From the centre, the elevations of a beam have a wider range than the beam spacing.
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
    LidarPoints one;
    one.position_m = {{5.0f, 0.0f, 0.0f}};
    one.intensity = {0.5f};
    one.ring = {0};
    EXPECT_THROW(fit_spinning_sensor({one}, 0.1), DataError);
}

StreetOptions options() {
    return {.n_frames = 12, .rows = 24, .columns = 512, .range_noise_m = 0.0, .moving_cars = false};
}

TEST(TwoLidars, WorldReturnsAreVehicleTimesMounting) {
    const Log street = test::make_two_lidar_street(options());
    const Lidar& rear = street.lidars[1];
    const Frame& frame = street.frames[7];
    ASSERT_EQ(frame.lidar, 1);
    for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 31) {
        if (!(frame.scan.range_m[i] > 0.0f)) continue;
        const double t_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
        const glm::dvec4 p = to_matrix(street.world_from_vehicle.pose_at(t_s)) *
                             to_matrix(rear.vehicle_from_sensor) *
                             glm::dvec4(glm::dvec3(frame.scan.return_point(i)), 1.0);
        EXPECT_LT(glm::distance(locate_return(street, frame, i).point_m, glm::dvec3(p)),
                  // tolerance: between poses, the LiDAR moves on an arc, but its
                  // interpolated position moves on the chord
                  1e-3);
    }
}

TEST(TwoLidars, ATurnIsHeldOutAsAWhole) {
    const Log street = test::make_two_lidar_street(options());
    const Split split = split_frames(street, 10);
    EXPECT_EQ(split.test, (std::vector<int>{20, 21}));
    EXPECT_EQ(split.train.size(), 22u);
    EXPECT_GT(predict_scan(street, 21, split.train, BoxPointMotion::stay).count_returns(), 1000u);
}

TEST(TwoLidars, LasersAreCountedThrough) {
    Log street = test::make_two_lidar_street(options());
    EXPECT_EQ(street.count_beams(), 36u);
    EXPECT_EQ(street.find_global_beam(0, 23), 23);
    EXPECT_EQ(street.find_global_beam(1, 0), 24);
    EXPECT_FALSE(street.find_global_beam(1, 12).has_value());
    for (Frame& frame : street.frames)
        for (float& range : frame.scan.range_m)
            if (frame.lidar == 1 && range > 0.0f) range += 0.06f;  // all beams of the second LiDAR
    ASSERT_TRUE(calibrate_ranges(street, split_frames(street, 0).train).adopted);
    double mean[2] = {0.0, 0.0};
    for (int l = 0; l < 2; ++l)
        for (std::size_t b = 4; b < 12; ++b)
            // the upper beams see no plane
            mean[l] += street.lidars[std::size_t(l)].sensor.beams[b].range_offset_m / 8.0;
    EXPECT_NEAR(mean[1] - mean[0], 0.06, 0.02);
}

}  // namespace
}  // namespace relidar
