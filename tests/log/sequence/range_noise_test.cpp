// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>

#include "base/random.hpp"

namespace relidar {
namespace {

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

TEST(RangeNoise, NothingSeenMeasuresNothing) {
    Log street = make_street_log({.n_frames = 2, .rows = 4, .columns = 16});
    EXPECT_EQ(calibrate_noise(street, {}), 0u);
    EXPECT_TRUE(street.lidars[0].range_noise.sigma_m.empty());
    EXPECT_EQ(street.lidars[0].range_noise.lookup_sigma_m(10.0, 1.0), 0.0);
}

}  // namespace
}  // namespace relidar
