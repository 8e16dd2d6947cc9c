// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include <relidar/log/sequence.hpp>

namespace relidar {
namespace {

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
