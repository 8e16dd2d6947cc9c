// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>

namespace relidar {
namespace {

/// Returns deterministic noise in -1..1.
double noise(std::uint64_t index) { return std::fmod(std::sin(double(index) * 12.9898) * 43758.5453, 1.0); }

/// Returns the brightness of the ground: a checkerboard of 0.5 m tiles.
double compute_brightness(const glm::dvec3& point) {
    return (int(std::floor(point.x * 2.0)) + int(std::floor(point.y * 2.0))) % 2 == 0 ? 0.3 : 0.6;
}

/// The sensor looks down from 2 m and drives forward: every beam measures the same tiles.
Log drive(const std::vector<Beam>& beams, double noise_size) {
    Log sequence;
    sequence.lidars[0].sensor.beams = beams;
    sequence.lidars[0].sensor.columns = 1440;
    sequence.rolling_shutter = false;
    std::uint64_t k = 0;
    for (int f = 0; f < 12; ++f) {
        Frame frame{f, 0.1 * f, {make_rays(sequence.lidars[0].sensor), {}, {}}};
        Pose pose;
        pose.translation = {0.37 * f, 0.0, 2.0};
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const glm::dvec3 d(frame.scan.rays.direction[i]);
            const double range = -2.0 / d.z;
            const Beam& beam = beams[frame.scan.rays.channel[i]];
            const double value = beam.intensity_gain * compute_brightness(pose.translation + range * d) +
                                 beam.intensity_offset + noise_size * noise(++k);
            frame.scan.range_m.push_back(float(range));
            frame.scan.intensity.push_back(float(value));
        }
        sequence.frames.push_back(frame);
        sequence.world_from_vehicle.time_s.push_back(frame.time_s);
        sequence.world_from_vehicle.pose.push_back(pose);
    }
    return sequence;
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
    Log sequence = drive(truth, 0.01);
    const IntensityCalibrationResult calibration = calibrate_intensity(sequence, kAll);
    ASSERT_GT(calibration.returns, 2000u);
    EXPECT_GT(calibration.rms_before, 3.0 * calibration.rms_after);
    // The data do not determine a common scale and offset of all beams.
    for (const double surface : {0.3, 0.6}) {
        const Beam &a = truth[0], &b = sequence.lidars[0].sensor.beams[0];
        const double common =
            (a.intensity_gain * surface + a.intensity_offset - b.intensity_offset) / b.intensity_gain;
        for (std::size_t k = 1; k < truth.size(); ++k) {
            const Beam& beam = sequence.lidars[0].sensor.beams[k];
            EXPECT_NEAR(beam.intensity_gain * common + beam.intensity_offset,
                        truth[k].intensity_gain * surface + truth[k].intensity_offset, 0.02)
                << k << " at " << surface;
        }
    }
    double gain = 0.0, offset = 0.0;
    for (const Beam& beam : sequence.lidars[0].sensor.beams) {
        gain += beam.intensity_gain;
        offset += beam.intensity_offset;
    }
    EXPECT_NEAR(gain / 8.0, 1.0, 0.05);
    EXPECT_NEAR(offset / 8.0, 0.0, 0.03);
}

TEST(IntensityResponse, EqualLasersStayEqual) {
    std::vector<Beam> beams = make_unequal_beams();
    for (Beam& beam : beams) beam.intensity_gain = 1.0, beam.intensity_offset = 0.0;
    Log sequence = drive(beams, 0.02);
    calibrate_intensity(sequence, kAll);
    for (const Beam& beam : sequence.lidars[0].sensor.beams)
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
    Log sequence = street();
    const IntensityCalibrationResult calibration =
        calibrate_intensity(sequence, split_frames(sequence, 0).train);
    EXPECT_TRUE(calibration.shared);
    EXPECT_FALSE(calibration.beams);
    for (const Beam& beam : sequence.lidars[0].sensor.beams) EXPECT_EQ(beam.intensity_gain, 1.0);
    expect_the_streets_fall(sequence.intensity_response, 0.04);
}

TEST(IntensityResponse, FallAndLasersAreToldApart) {
    Log sequence = street();
    std::vector<double> gains;
    double mean = 0.0;
    for (std::size_t b = 0; b < sequence.lidars[0].sensor.beams.size(); ++b) {
        gains.push_back(1.0 + 0.25 * noise(b + 5));
        mean += gains.back() / double(sequence.lidars[0].sensor.beams.size());
    }
    for (Frame& frame : sequence.frames)
        for (std::size_t i = 0; i < frame.scan.intensity.size(); ++i)
            frame.scan.intensity[i] *= float(gains[frame.scan.rays.channel[i]]);
    const IntensityCalibrationResult calibration =
        calibrate_intensity(sequence, split_frames(sequence, 0).train);
    EXPECT_TRUE(calibration.shared && calibration.beams);
    // A beam sees the ground at a single range.
    expect_the_streets_fall(sequence.intensity_response, 0.06);
    double ratio = 0.0;  // the mean beam is weighted by returns
    for (std::size_t b = 0; b < gains.size(); ++b)
        ratio += sequence.lidars[0].sensor.beams[b].intensity_gain / gains[b] / double(gains.size());
    // skips the first beams, which point into the sky and have few returns
    for (std::size_t b = 4; b < gains.size(); ++b)
        EXPECT_NEAR(sequence.lidars[0].sensor.beams[b].intensity_gain / gains[b] / ratio, 1.0, 0.08) << b;
}

TEST(IntensityResponse, OnlyTheGivenFramesAreLookedAt) {
    Log original = drive(make_unequal_beams(), 0.01), changed = original;
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

TEST(IntensityResponse, NothingSharedLeavesTheSensorAlone) {
    Log sequence = drive(make_unequal_beams(), 0.0);
    const IntensityCalibrationResult calibration = calibrate_intensity(sequence, {});
    EXPECT_EQ(calibration.returns, 0u);
    for (const Beam& beam : sequence.lidars[0].sensor.beams) EXPECT_EQ(beam.intensity_gain, 1.0);
}

TEST(IntensityResponse, SurfaceIntensityUndoesTheResponse) {
    Log sequence = drive(make_unequal_beams(), 0.0);
    const Frame& frame = sequence.frames[3];
    for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 7) {
        const WorldReturn w = locate_return(sequence, frame, i);
        EXPECT_NEAR(w.intensity, surface_return(sequence, frame, i).intensity, 0.0);
        const Beam& beam = sequence.lidars[0].sensor.beams[frame.scan.rays.channel[i]];
        EXPECT_NEAR(beam.intensity_gain * double(w.intensity) + beam.intensity_offset,
                    double(frame.scan.intensity[i]), 1e-6);
    }
    const float original_intensity = surface_return(sequence, frame, 3).intensity;
    sequence.intensity_response = {{0.0, 100.0}, {0.5, 0.5}, 0.0};
    EXPECT_NEAR(surface_return(sequence, frame, 3).intensity, 2.0f * original_intensity, 1e-6f)
        << "what falls to half was twice as bright";
}

}  // namespace
}  // namespace relidar
