// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <gtest/gtest.h>

#include <relidar/score/metrics.hpp>

#include "support/two_lidars.hpp"

namespace relidar {
namespace {

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

/// Compares the road heights in cells of half a metre in which both have returns.
double measure_height_difference_m(const Log& street) {
    std::map<std::tuple<int, int>, double> sum[2], count[2];
    for (const Frame& frame : street.frames)
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f) || frame.scan.range_m[i] > 25.0f) continue;
            const glm::dvec3 p = locate_return(street, frame, i).point_m;
            // The road is at height 0 of the street.
            if (std::abs(p.z + street.world_offset_m.z) > 0.5) continue;
            const std::tuple cell(int(std::floor(2.0 * p.x)), int(std::floor(2.0 * p.y)));
            sum[frame.lidar][cell] += p.z;
            count[frame.lidar][cell] += 1.0;
        }
    double difference = 0.0, n = 0.0;
    for (const auto& [cell, total] : sum[0])
        if (count[1].contains(cell)) {
            difference += std::abs(total / count[0][cell] - sum[1][cell] / count[1][cell]);
            n += 1.0;
        }
    EXPECT_GT(n, 50.0);
    return difference / n;
}

TEST(TwoLidars, BothSeeTheSameRoad) {
    Log street = test::make_two_lidar_street(options());
    EXPECT_LT(measure_height_difference_m(street), 0.02) << "pavements are 0.1 m higher";
    street.lidars[1].vehicle_from_sensor.translation.z += 0.15;
    EXPECT_GT(measure_height_difference_m(street), 0.1) << "a wrong mounting shows";
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
