// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor.hpp>

#include <gtest/gtest.h>

#include <relidar/base/math.hpp>
#include "base/random.hpp"

namespace relidar {
namespace {

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

}  // namespace
}  // namespace relidar
