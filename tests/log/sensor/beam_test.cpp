// SPDX-License-Identifier: Apache-2.0
// Checks the measurement model of a beam. Its two directions must be inverse to each
// other. The firing azimuth computed from a point must be the original azimuth.
#include <relidar/log/sensor.hpp>

#include <cmath>

#include <gtest/gtest.h>

#include <relidar/base/math.hpp>
#include "base/random.hpp"

namespace relidar {
namespace {

TEST(Beam, MeasuringAndItsInverseArePairs) {
    Random random(11);
    for (int i = 0; i < 1000; ++i) {
        const Beam beam{.intensity_gain = 0.5 + random.sample_uniform_number(),
                        .intensity_offset = 0.1 * random.sample_uniform_number(),
                        .range_offset_m = 0.2 * random.sample_uniform_number() - 0.1};
        const double range = 1.0 + 80.0 * random.sample_uniform_number(),
                     fall = 0.3 + 0.5 * random.sample_uniform_number(),
                     albedo = 0.6 * random.sample_uniform_number();
        EXPECT_NEAR(beam.convert_measured_to_surface_range_m(beam.convert_surface_to_measured_range_m(range)),
                    range, 1e-12);
        EXPECT_NEAR(beam.convert_surface_to_measured_range_m(beam.convert_measured_to_surface_range_m(range)),
                    range, 1e-12);
        EXPECT_NEAR(beam.convert_measured_to_surface_intensity(
                        beam.convert_surface_to_measured_intensity(albedo, fall), fall),
                    albedo, 1e-12);
    }
}

TEST(Beam, CutsWhatItCannotMeasure) {
    const Beam beam{.intensity_gain = 2.0, .intensity_offset = -0.1, .range_offset_m = -0.5};
    EXPECT_EQ(beam.convert_surface_to_measured_intensity(0.9, 1.0), 1.0);
    EXPECT_EQ(beam.convert_surface_to_measured_intensity(0.01, 1.0), 0.0);
    EXPECT_NEAR(beam.convert_surface_to_measured_intensity(0.3, 0.5), 2.0 * 0.5 * 0.3 - 0.1, 1e-15);
    EXPECT_EQ(beam.convert_surface_to_measured_range_m(0.2), 0.0);
    EXPECT_EQ(beam.convert_surface_to_measured_range_m(0.0), 0.0) << "nothing came back";
    EXPECT_EQ(beam.convert_measured_to_surface_range_m(0.0), 0.0);
    EXPECT_EQ((Beam{.range_offset_m = 3.0}.convert_measured_to_surface_range_m(1.0)), 1e-3);
}

TEST(HeadAzimuth, IsTheHeadThatFired) {
    Random random(12);
    for (int i = 0; i < 1000; ++i) {
        const Beam beam{.elevation_rad = random.sample_uniform_number() - 0.5,
                        .azimuth_offset_rad = 0.4 * random.sample_uniform_number() - 0.2,
                        .origin_offset_m = 0.1 * random.sample_uniform_number(),
                        .origin_up_m = 0.3 * random.sample_uniform_number(),
                        .origin_left_m = 0.1 * random.sample_uniform_number() - 0.05};
        const double head = 2.0 * kPi * (random.sample_uniform_number() - 0.5),
                     range = 1.0 + 60.0 * random.sample_uniform_number();
        const BeamRay ray = compute_beam_ray(beam, head);
        EXPECT_NEAR(
            std::remainder(
                compute_head_azimuth_facing_point_rad(beam, ray.origin_m + range * ray.direction) - head,
                2.0 * kPi),
            0.0, 1e-12);
    }
}

}  // namespace
}  // namespace relidar
