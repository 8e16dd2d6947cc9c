// SPDX-License-Identifier: Apache-2.0
// Compares calibrations with the exact values of simulated sensors.
#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/log/calibration.hpp>
#include <relidar/log/log.hpp>
#include <relidar/read/dataset.hpp>
#include "base/random.hpp"

namespace relidar {
namespace {

/// Returns deterministic noise in -1..1.
double noise(std::uint64_t index) { return std::fmod(std::sin(double(index) * 12.9898) * 43758.5453, 1.0); }

/// Returns the brightness of the ground: a checkerboard of 0.5 m tiles.
double compute_brightness(const glm::dvec3& point) {
    return (int(std::floor(point.x * 2.0)) + int(std::floor(point.y * 2.0))) % 2 == 0 ? 0.3 : 0.6;
}

/// Drives 2 m above the ground, by `step_m` per frame. measure(beam, origin, direction,
/// frame) returns the range and the intensity of a ray.
template <class Measure>
Log drive(const std::vector<Beam>& beams, int n_frames, const glm::dvec3& step_m, const Measure& measure) {
    Log log;
    log.lidars[0].sensor.beams = beams;
    log.lidars[0].sensor.columns = 1440;
    log.rolling_shutter = false;
    for (int f = 0; f < n_frames; ++f) {
        Frame frame{f, 0.1 * f, {make_rays(log.lidars[0].sensor), {}, {}}};
        const Pose pose{{1, 0, 0, 0}, double(f) * step_m + glm::dvec3(0.0, 0.0, 2.0)};
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const auto [range_m, intensity] = measure(frame.scan.rays.channel[i], pose.translation,
                                                      glm::dvec3(frame.scan.rays.direction[i]), f);
            frame.scan.range_m.push_back(float(range_m));
            frame.scan.intensity.push_back(float(intensity));
        }
        log.frames.push_back(frame);
        log.world_from_vehicle.append(frame.time_s, pose);
    }
    return log;
}

/// The sensor looks down: every beam measures the same tiles.
Log drive_over_tiles(const std::vector<Beam>& beams, double noise_size) {
    std::uint64_t k = 0;
    const auto measure = [&](std::size_t b, const glm::dvec3& origin, const glm::dvec3& d, int) {
        const double range = -2.0 / d.z;
        return std::pair(range, beams[b].intensity_gain * compute_brightness(origin + range * d) +
                                    beams[b].intensity_offset + noise_size * noise(++k));
    };
    return drive(beams, 12, {0.37, 0.0, 0.0}, measure);
}

const std::vector<int> kAll{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};

std::vector<Beam> make_unequal_beams() {
    std::vector<Beam> beams(8);
    double gain = 0.0, offset = 0.0;
    for (std::size_t b = 0; b < beams.size(); ++b) {
        beams[b].elevation_rad = -0.35 - 0.02 * double(b);
        beams[b].intensity_gain = 1.0 + 0.3 * noise(b + 3);
        beams[b].intensity_offset = 0.1 * noise(b + 17);
        gain += beams[b].intensity_gain / 8.0;
        offset += beams[b].intensity_offset / 8.0;
    }
    for (Beam& beam : beams) {  // normalised to a mean beam of 1
        beam.intensity_gain /= gain;
        beam.intensity_offset -= beam.intensity_gain * offset;
    }
    return beams;
}

TEST(IntensityResponse, ComesBackFromSharedPlaces) {
    const std::vector<Beam> truth = make_unequal_beams();
    Log log = drive_over_tiles(truth, 0.01);
    const IntensityCalibrationResult calibration = calibrate_intensity(log, kAll);
    ASSERT_GT(calibration.returns, 2000u);
    EXPECT_GT(calibration.rms_before, 3.0 * calibration.rms_after);
    // The data do not determine a common scale and offset of all beams.
    for (const double surface : {0.3, 0.6}) {
        const Beam &a = truth[0], &b = log.lidars[0].sensor.beams[0];
        const double common =
            (a.intensity_gain * surface + a.intensity_offset - b.intensity_offset) / b.intensity_gain;
        for (std::size_t k = 1; k < truth.size(); ++k) {
            const Beam& beam = log.lidars[0].sensor.beams[k];
            EXPECT_NEAR(beam.intensity_gain * common + beam.intensity_offset,
                        truth[k].intensity_gain * surface + truth[k].intensity_offset, 0.02)
                << k << " at " << surface;
        }
    }
    double gain = 0.0, offset = 0.0;
    for (const Beam& beam : log.lidars[0].sensor.beams) {
        gain += beam.intensity_gain;
        offset += beam.intensity_offset;
    }
    EXPECT_NEAR(gain / 8.0, 1.0, 0.05);
    EXPECT_NEAR(offset / 8.0, 0.0, 0.03);
}

TEST(IntensityResponse, EqualLasersStayEqual) {
    std::vector<Beam> beams = make_unequal_beams();
    for (Beam& beam : beams) beam.intensity_gain = 1.0, beam.intensity_offset = 0.0;
    Log log = drive_over_tiles(beams, 0.02);
    calibrate_intensity(log, kAll);
    for (const Beam& beam : log.lidars[0].sensor.beams)
        for (const double surface : {0.3, 0.6})
            EXPECT_NEAR(beam.intensity_gain * surface + beam.intensity_offset, surface, 0.015);
}

/// Intensities are reflectance * (0.3 + 0.7 cos) * (1 - range / 160 m).
Log street() {
    return make_street_log({.n_frames = 40});  // 32 m: near and far views of the same surfaces
}

void expect_the_streets_fall(const IntensityResponse& calibration, double tolerance) {
    const auto exact = [](double range_m) { return (1.0 - range_m / 160.0) / (1.0 - 10.0 / 160.0); };
    for (const double range_m : {4.0, 7.0, 15.0, 25.0, 40.0})
        EXPECT_NEAR(calibration.range_factor(range_m) / exact(range_m), 1.0, tolerance) << range_m;
    EXPECT_NEAR(calibration.incidence, 0.7, 0.05);
}

TEST(IntensityResponse, FallWithRangeAndIncidenceIsNotTheLasers) {
    Log log = street();
    const IntensityCalibrationResult calibration = calibrate_intensity(log, split_frames(log, 0).train);
    EXPECT_TRUE(calibration.shared);
    EXPECT_FALSE(calibration.beams);
    for (const Beam& beam : log.lidars[0].sensor.beams) EXPECT_EQ(beam.intensity_gain, 1.0);
    expect_the_streets_fall(log.intensity_response, 0.04);
}

/// Intensities are reflectance * (0.3 + 0.7 cos) * 0.3 (10 m / range)^2, limited by the
/// noise of the receiver only.
TEST(IntensityResponse, FollowsReceivedPowerDownToTheWeakestReturns) {
    Log log = street();
    const auto power = [](double range_m) { return 100.0 / (range_m * range_m); };
    for (Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.intensity.size(); ++i)
            if (const double range_m = frame.scan.range_m[i]; range_m > 0.0)
                frame.scan.intensity[i] *= float(0.3 * power(range_m) / (1.0 - range_m / 160.0));
    calibrate_intensity(log, split_frames(log, 0).train);
    for (const double range_m : {4.0, 7.0, 15.0, 20.0, 30.0, 45.0, 60.0})
        EXPECT_NEAR(log.intensity_response.range_factor(range_m) / power(range_m), 1.0, 0.1) << range_m;
}

TEST(IntensityResponse, FallAndLasersAreToldApart) {
    Log log = street();
    std::vector<double> gains;
    double mean = 0.0;
    for (std::size_t b = 0; b < log.lidars[0].sensor.beams.size(); ++b) {
        gains.push_back(1.0 + 0.25 * noise(b + 5));
        mean += gains.back() / double(log.lidars[0].sensor.beams.size());
    }
    for (Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.intensity.size(); ++i)
            frame.scan.intensity[i] *= float(gains[frame.scan.rays.channel[i]]);
    const IntensityCalibrationResult calibration = calibrate_intensity(log, split_frames(log, 0).train);
    EXPECT_TRUE(calibration.shared && calibration.beams);
    // A beam sees the ground at a single range.
    expect_the_streets_fall(log.intensity_response, 0.06);
    double ratio = 0.0;  // the mean beam is weighted by returns
    for (std::size_t b = 0; b < gains.size(); ++b)
        ratio += log.lidars[0].sensor.beams[b].intensity_gain / gains[b] / double(gains.size());
    // skips the first beams, which point into the sky and have few returns
    for (std::size_t b = 4; b < gains.size(); ++b)
        EXPECT_NEAR(log.lidars[0].sensor.beams[b].intensity_gain / gains[b] / ratio, 1.0, 0.08) << b;
}

TEST(IntensityResponse, OnlyTheGivenFramesAreLookedAt) {
    Log original = drive_over_tiles(make_unequal_beams(), 0.01), changed = original;
    for (float& value : changed.frames[5].scan.intensity) value = 0.9f;
    const std::vector<int> without{0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11};
    calibrate_intensity(original, without);
    calibrate_intensity(changed, without);
    for (std::size_t b = 0; b < 8; ++b) {
        const Beam &first = original.lidars[0].sensor.beams[b], &second = changed.lidars[0].sensor.beams[b];
        EXPECT_EQ(first.intensity_gain, second.intensity_gain);
        EXPECT_EQ(first.intensity_offset, second.intensity_offset);
    }
}

TEST(IntensityResponse, SurfaceIntensityUndoesTheResponse) {
    Log log = drive_over_tiles(make_unequal_beams(), 0.0);
    const Frame& frame = log.frames[3];
    for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 7) {
        const WorldReturn w = locate_return(log, frame, i);
        EXPECT_NEAR(w.intensity, surface_return(log, frame, i).intensity, 0.0);
        const Beam& beam = log.lidars[0].sensor.beams[frame.scan.rays.channel[i]];
        EXPECT_NEAR(beam.intensity_gain * double(w.intensity) + beam.intensity_offset,
                    double(frame.scan.intensity[i]), 1e-6);
    }
    const float original_intensity = surface_return(log, frame, 3).intensity;
    log.intensity_response = {{1.0, 100.0}, {0.5, 0.5}, 0.0};
    EXPECT_NEAR(surface_return(log, frame, 3).intensity, 2.0f * original_intensity, 1e-6f)
        << "what falls to half was twice as bright";
}

TEST(RangeNoise, ComesBackFromASmoothStreet) {
    Log street = make_street_log(
        {.n_frames = 24, .rows = 64, .columns = 1024, .range_noise_m = 0.0, .moving_cars = false});
    const RangeNoiseTable& noise = street.lidars[0].range_noise;
    const auto sigma = [](float range_m) { return range_m < 20.0f ? 0.01 : 0.04; };
    Random random(5);
    for (Frame& frame : street.frames)
        for (float& range : frame.scan.range_m)
            if (range > 0.0f) range += static_cast<float>(sigma(range) * random.sample_normal());
    const std::vector<int> all = split_frames(street, 0).train;
    ASSERT_GT(calibrate_noise(street, all), 10000u);
    for (const double cosine : {0.5, 1.0}) {
        EXPECT_NEAR(noise.lookup_sigma_m(8.0, cosine), 0.01, 0.001) << cosine;
        EXPECT_NEAR(noise.lookup_sigma_m(15.0, cosine), 0.01, 0.001) << cosine;
        // So far away, few surfaces are hit squarely, and many returns are at edges.
        EXPECT_NEAR(noise.lookup_sigma_m(25.0, cosine), 0.04, cosine < 0.6 ? 0.004 : 0.012);
    }
    EXPECT_EQ(noise.lookup_sigma_m(500.0, 1.0), noise.lookup_sigma_m(79.0, 1.0)) << "the last bin goes on";
}

TEST(RangeNoise, EachLidarHasItsOwn) {
    const auto street_of = [](double noise_m) {
        return make_street_log(
            {.n_frames = 8, .rows = 32, .columns = 512, .range_noise_m = noise_m, .moving_cars = false});
    };
    Log both = street_of(0.005);
    both.lidars.push_back(both.lidars[0]);
    both.lidars.push_back(both.lidars[0]);  // a LiDAR without sweeps
    for (Frame& frame : street_of(0.03).frames) {
        frame.lidar = 1;
        both.frames.push_back(std::move(frame));
    }
    ASSERT_GT(calibrate_noise(both, split_frames(both, 0).train), 10000u);
    EXPECT_NEAR(both.lidars[0].range_noise.lookup_sigma_m(8.0, 1.0), 0.005, 0.0005);
    EXPECT_NEAR(both.lidars[1].range_noise.lookup_sigma_m(8.0, 1.0), 0.03, 0.003);
    EXPECT_TRUE(both.lidars[2].range_noise.sigma_m.empty());
}

const std::vector<double> kOffsets_m{0.05, -0.03, 0.02, -0.06, 0.01, 0.04, -0.05, 0.02};  // the sum is 0

/// A ground plane, a wall on each side, and square posts with surfaces across the street.
double cast(const glm::dvec3& o, const glm::dvec3& direction) {
    double nearest = 1e9;
    const auto plane = [&](int axis, double at, auto&& on) {
        const double t = (at - o[axis]) / direction[axis];
        if (t > 0.1 && t < nearest && on(o + t * direction)) nearest = t;
    };
    plane(2, 0.0, [](const glm::dvec3&) { return true; });
    for (const double side : {-4.0, 5.0})
        plane(1, side, [](const glm::dvec3& point) { return point.z < 6.0; });
    for (int k = -4; k < 8; ++k)
        plane(0, 5.0 * k, [](const glm::dvec3& point) { return point.y > 3.0 || point.y < -2.5; });
    return nearest;
}

/// The ranges have the offset of their beam and 5 mm of deterministic noise.
Log drive_through_street(bool held_out_is_garbage = false) {
    std::vector<Beam> beams;
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        beams.push_back({.elevation_rad = -0.03 - 0.04 * double(b)});
    std::uint64_t k = 0;
    const auto measure = [&](std::size_t b, const glm::dvec3& origin, const glm::dvec3& direction, int f) {
        const double range = cast(origin, direction), off_m = kOffsets_m[b] + 0.005 * noise(++k);
        if (held_out_is_garbage && f == 5) return std::pair(3.0, 0.5);
        return std::pair(range > 60.0 ? 0.0 : range + off_m, 0.5);
    };
    return drive(beams, 10, {0.83, 0.1, 0.0}, measure);
}

const std::vector<int> kTrain{0, 1, 2, 3, 4, 6, 7, 8, 9};

TEST(RangeOffset, ComesBackFromSharedPlanes) {
    Log log = drive_through_street();
    const RangeCalibrationResult calibration = calibrate_ranges(log, kTrain);
    ASSERT_GT(calibration.returns, 20000u);
    EXPECT_GT(calibration.rms_before, 2.0 * calibration.rms_after);
    double mean = 0.0;
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        mean += (log.lidars[0].sensor.beams[b].range_offset_m - kOffsets_m[b]) / double(kOffsets_m.size());
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        EXPECT_NEAR(log.lidars[0].sensor.beams[b].range_offset_m - mean, kOffsets_m[b], 0.008) << b;
    EXPECT_NEAR(mean, 0.0, 0.02);
}

TEST(RangeOffset, HeldOutFramesAreNotLookedAt) {
    Log clean = drive_through_street(), garbage = drive_through_street(true);
    calibrate_ranges(clean, kTrain);
    calibrate_ranges(garbage, kTrain);
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        EXPECT_EQ(clean.lidars[0].sensor.beams[b].range_offset_m,
                  garbage.lidars[0].sensor.beams[b].range_offset_m);
}

TEST(RangeOffset, ReturnsComeFromWhereTheSurfaceIs) {
    Log log = drive_through_street();
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        log.lidars[0].sensor.beams[b].range_offset_m = kOffsets_m[b];
    const Frame& frame = log.frames[2];
    for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 13) {
        if (!(frame.scan.range_m[i] > 0.0f)) continue;
        const WorldRay ray = make_world_ray(log.world_from_vehicle, frame.time_s, frame.scan.rays, i, false);
        EXPECT_NEAR(glm::distance(locate_return(log, frame, i).point_m, ray.origin_m),
                    cast(ray.origin_m, ray.direction), 0.006);
    }
}

TEST(RangeOffset, EqualLasersHaveNone) {
    Log log = drive_through_street();
    for (Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (frame.scan.range_m[i] > 0.0f)
                frame.scan.range_m[i] -= float(kOffsets_m[frame.scan.rays.channel[i]]);
    EXPECT_GT(calibrate_ranges(log, kTrain).returns, 20000u);
    for (const Beam& beam : log.lidars[0].sensor.beams) EXPECT_EQ(beam.range_offset_m, 0.0);
}

TEST(Calibration, NothingToCompareLeavesTheSensorAlone) {
    Log log = drive_over_tiles(make_unequal_beams(), 0.0);
    EXPECT_EQ(calibrate_intensity(log, {}).returns, 0u);
    EXPECT_EQ(calibrate_ranges(log, {}).returns, 0u);
    EXPECT_EQ(calibrate_noise(log, {}), 0u);
    for (const Beam& beam : log.lidars[0].sensor.beams) {
        EXPECT_EQ(beam.intensity_gain, 1.0);
        EXPECT_EQ(beam.range_offset_m, 0.0);
    }
    EXPECT_TRUE(log.lidars[0].range_noise.sigma_m.empty());
    EXPECT_EQ(log.lidars[0].range_noise.lookup_sigma_m(10.0, 1.0), 0.0);
}

constexpr int kColumns = 1024;
constexpr double kColumn_rad = 2.0 * kPi / kColumns;

/// Makes a sensor with 16 beams, azimuth offsets of up to nine columns, and a second
/// optical centre.
SpinningSensor sensor() {
    SpinningSensor result;
    result.name = "16 beams";
    result.columns = kColumns;
    for (int i = 0; i < 16; ++i)
        result.beams.push_back({.elevation_rad = 0.02 * (4 - i),
                                .azimuth_offset_rad = (i % 4 - 1.5) * 6.0 * kColumn_rad,
                                .origin_left_m = i < 8 ? 0.03 : -0.03});
    return result;
}

/// A parabola from 3 to -5 mrad, and an error that repeats in each packet of 7 firings.
double compute_unevenness(int firing) {
    const double x = double(firing) / kColumns;
    return 3e-3 - 4e-3 * x - 4e-3 * x * x + 4e-4 * (firing % 7 - 3);
}

glm::vec3 rotate_vector(const glm::vec3& vector, double angle) {
    const double c = std::cos(angle), s = std::sin(angle);
    return {float(c * vector.x - s * vector.y), float(s * vector.x + c * vector.y), vector.z};
}

int get_firing(const SpinningSensor& sensor, std::size_t ray) {
    const int column = int(ray) % kColumns;
    const Beam& beam = sensor.beams[ray / kColumns];
    return (column + offset_columns(beam, kColumns) + kColumns) % kColumns;
}

/// Each ray has an error of up to 0.02 mrad. Only a share of the rays has a return.
Scan make_uneven_scan(double share, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    Scan scan;
    scan.rays = make_rays(sensor());
    for (std::size_t i = 0; i < scan.rays.size(); ++i) {
        scan.rays.direction[i] =
            rotate_vector(scan.rays.direction[i],
                          compute_unevenness(get_firing(sensor(), i)) + 2e-5 * (2.0 * unit(random) - 1.0));
        scan.range_m.push_back(unit(random) < share ? 20.0f : 0.0f);
        scan.intensity.push_back(0.0f);
    }
    return scan;
}

std::vector<float> shift_of(const Scan& scan) {
    return measure_shifts_rad(scan, sensor(), make_rays(sensor()));
}

double compute_worst_angle(const RayTable& first, const RayTable& second) {
    double worst = 0.0;
    for (std::size_t i = 0; i < first.size(); ++i)
        worst = std::max(worst, double(glm::length(first.direction[i] - second.direction[i])));
    return worst;
}

TEST(AzimuthShift, IsFoundAndPutBackOn) {
    const RayTable nominal = make_rays(sensor());
    for (const double share : {1.0, 0.6}) {
        const Scan scan = make_uneven_scan(share, 3);
        const std::vector<float> shift_rad = shift_of(scan);
        ASSERT_EQ(shift_rad.size(), std::size_t(kColumns));
        EXPECT_GT(compute_worst_angle(nominal, scan.rays), 5e-3);
        EXPECT_LT(compute_worst_angle(rotate_firings(nominal, sensor(), shift_rad), scan.rays), 5e-5)
            << "each ray's own 0.02 mrad, twice";
    }
}

TEST(AzimuthShift, TurnsOriginsAlong) {
    const RayTable nominal = make_rays(sensor());
    const RayTable uneven = rotate_firings(nominal, sensor(), std::vector<float>(kColumns, 0.01f));
    for (std::size_t i = 0; i < nominal.size(); ++i) {
        ASSERT_LT(glm::length(uneven.origin[i] - rotate_vector(nominal.origin[i], 0.01)), 1e-8f);
        ASSERT_LT(glm::length(uneven.direction[i] - rotate_vector(nominal.direction[i], 0.01)), 1e-6f);
        ASSERT_EQ(uneven.time_offset_s[i], nominal.time_offset_s[i]);
    }
}

/// A pane of glass removes returns of half of the beams in some columns. The azimuths
/// must not reveal which rays were dropped.
TEST(AzimuthShift, SaysNothingOfWhichRaysWereDropped) {
    Scan scan = make_uneven_scan(1.0, 5);
    const std::vector<float> before = shift_of(scan);
    for (std::size_t i = 0; i < scan.rays.size(); ++i)
        if (i / kColumns < 8 && i % kColumns > 500 && i % kColumns < 540) scan.range_m[i] = 0.0f;
    const std::vector<float> after = shift_of(scan);
    ASSERT_EQ(after.size(), before.size());
    for (std::size_t f = 0; f < after.size(); ++f)
        ASSERT_NEAR(after[f], before[f], 4e-5) << "the spread within a firing";
}

TEST(AzimuthShift, FiringsWithoutReturnsAreBetweenTheirNeighbours) {
    Scan scan = make_uneven_scan(1.0, 7);
    const auto hide = [&](int first, int end) {
        for (std::size_t i = 0; i < scan.rays.size(); ++i)
            if (const int firing = get_firing(sensor(), i); firing >= first && firing < end)
                scan.range_m[i] = 0.0f;
    };
    hide(0, 10);
    hide(300, 321);
    hide(1000, kColumns);
    const std::vector<float> shift_rad = shift_of(scan);
    ASSERT_EQ(shift_rad.size(), std::size_t(kColumns));
    EXPECT_EQ(shift_rad[0], shift_rad[10]);
    EXPECT_EQ(shift_rad[kColumns - 1], shift_rad[999]);
    for (const int firing : {300, 310, 320}) {
        const double s = (firing - 299) / 22.0;
        EXPECT_NEAR(shift_rad[std::size_t(firing)], (1.0 - s) * shift_rad[299] + s * shift_rad[321], 1e-6);
    }
}

TEST(AzimuthShift, IsNotThereWhereNothingSaysIt) {
    const RayTable nominal = make_rays(sensor());
    Scan even = make_uneven_scan(1.0, 1);
    even.rays = nominal;
    EXPECT_TRUE(shift_of(even).empty()) << "where it nominally is";
    EXPECT_TRUE(shift_of(make_uneven_scan(0.0, 1)).empty()) << "no returns";
    EXPECT_TRUE(measure_shifts_rad(make_uneven_scan(1.0, 1), sensor(), {}).empty()) << "no nominal rays";
    Scan other = make_uneven_scan(1.0, 1);
    other.rays.rows = 8;
    other.rays.columns = 2 * kColumns;
    EXPECT_TRUE(shift_of(other).empty()) << "another order";
    Scan apart = make_uneven_scan(1.0, 1);
    for (std::size_t i = 0; i < apart.rays.size(); ++i)
        apart.rays.direction[i] =
            rotate_vector(apart.rays.direction[i], double(i / kColumns % 5) * 0.4 * kColumn_rad);
    EXPECT_TRUE(shift_of(apart).empty()) << "beams that do not turn together";
    EXPECT_EQ(compute_worst_angle(rotate_firings(nominal, sensor(), {}), nominal), 0.0);
}

}  // namespace
}  // namespace relidar
