// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gtest/gtest.h>

#include <relidar/log/sequence.hpp>

namespace relidar {
namespace {

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
Log drive(bool held_out_is_garbage = false) {
    Log sequence;
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        sequence.lidars[0].sensor.beams.push_back({.elevation_rad = -0.03 - 0.04 * double(b)});
    sequence.lidars[0].sensor.columns = 1440;
    sequence.rolling_shutter = false;
    std::uint64_t k = 0;
    for (int f = 0; f < 10; ++f) {
        Frame frame{f, 0.1 * f, {make_rays(sequence.lidars[0].sensor), {}, {}}};
        Pose pose;
        pose.translation = {0.83 * f, 0.1 * f, 2.0};
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const double noise = 0.005 * std::fmod(std::sin(double(++k) * 12.9898) * 43758.5453, 1.0);
            const double range = cast(pose.translation, glm::dvec3(frame.scan.rays.direction[i]));
            frame.scan.range_m.push_back(
                range > 60.0 ? 0.0f : float(range + kOffsets_m[frame.scan.rays.channel[i]] + noise));
            if (held_out_is_garbage && f == 5) frame.scan.range_m.back() = 3.0f;
            frame.scan.intensity.push_back(0.5f);
        }
        sequence.frames.push_back(frame);
        sequence.world_from_vehicle.time_s.push_back(frame.time_s);
        sequence.world_from_vehicle.pose.push_back(pose);
    }
    return sequence;
}

const std::vector<int> kTrain{0, 1, 2, 3, 4, 6, 7, 8, 9};

TEST(RangeOffset, ComesBackFromSharedPlanes) {
    Log sequence = drive();
    const RangeCalibrationResult calibration = calibrate_ranges(sequence, kTrain);
    ASSERT_GT(calibration.returns, 20000u);
    EXPECT_GT(calibration.rms_before, 2.0 * calibration.rms_after);
    double mean = 0.0;
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        mean +=
            (sequence.lidars[0].sensor.beams[b].range_offset_m - kOffsets_m[b]) / double(kOffsets_m.size());
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        EXPECT_NEAR(sequence.lidars[0].sensor.beams[b].range_offset_m - mean, kOffsets_m[b], 0.008) << b;
    EXPECT_NEAR(mean, 0.0, 0.02);
}

TEST(RangeOffset, HeldOutFramesAreNotLookedAt) {
    Log clean = drive(), garbage = drive(true);
    calibrate_ranges(clean, kTrain);
    calibrate_ranges(garbage, kTrain);
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        EXPECT_EQ(clean.lidars[0].sensor.beams[b].range_offset_m,
                  garbage.lidars[0].sensor.beams[b].range_offset_m);
}

TEST(RangeOffset, ReturnsComeFromWhereTheSurfaceIs) {
    Log sequence = drive();
    for (std::size_t b = 0; b < kOffsets_m.size(); ++b)
        sequence.lidars[0].sensor.beams[b].range_offset_m = kOffsets_m[b];
    const Frame& frame = sequence.frames[2];
    for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 13) {
        if (!(frame.scan.range_m[i] > 0.0f)) continue;
        const WorldRay ray =
            make_world_ray(sequence.world_from_vehicle, frame.time_s, frame.scan.rays, i, false);
        EXPECT_NEAR(glm::distance(locate_return(sequence, frame, i).point_m, ray.origin_m),
                    cast(ray.origin_m, ray.direction), 0.006);
    }
}

TEST(RangeOffset, EqualLasersHaveNone) {
    Log sequence = drive();
    for (Frame& frame : sequence.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (frame.scan.range_m[i] > 0.0f)
                frame.scan.range_m[i] -= float(kOffsets_m[frame.scan.rays.channel[i]]);
    EXPECT_GT(calibrate_ranges(sequence, kTrain).returns, 20000u);
    for (const Beam& beam : sequence.lidars[0].sensor.beams) EXPECT_EQ(beam.range_offset_m, 0.0);
}

TEST(RangeOffset, NothingToCompareLeavesTheSensorAlone) {
    Log sequence = drive();
    EXPECT_EQ(calibrate_ranges(sequence, {}).returns, 0u);
    for (const Beam& beam : sequence.lidars[0].sensor.beams) EXPECT_EQ(beam.range_offset_m, 0.0);
}

}  // namespace
}  // namespace relidar
