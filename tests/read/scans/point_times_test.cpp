// SPDX-License-Identifier: Apache-2.0
// The truth is a sweep of 0.1 s whose times a driver would write in some type and unit.
#include "read/scans/point_times.hpp"

#include <cmath>

#include <gmock/gmock.h>

#include "read/scans/cloud_units.hpp"

namespace relidar::bag {
namespace {

constexpr double kStamp_s = 1.7e9, kCounter = 4294967296.0;
constexpr std::size_t kPoints = 1000, kClouds = 6;

/// Returns clouds whose times are value(t, k) for the times t of a sweep and the cloud k.
template <class Number>
std::vector<read::PointTable> make_clouds(read::ScalarType type,
                                          const std::function<double(double, double)>& value) {
    std::vector<read::PointTable> clouds;
    for (std::size_t k = 0; k < kClouds; ++k) {
        std::vector<Number> times;
        for (std::size_t i = 0; i < kPoints; ++i) times.push_back(Number(value(1e-4 * double(i), double(k))));
        clouds.emplace_back(kPoints).add_value_field("t", type, std::move(times), "test");
        read::unwrap_times(clouds.back(), false);
    }
    return clouds;
}
const auto make_u4 = [](const auto& value) {
    return make_clouds<std::uint32_t>(read::ScalarType::u4, [&](double t_s, double k) {
        return std::fmod(std::round(value(t_s, k)) + kCounter, kCounter);
    });
};
const auto make_f4 = [](const auto& value) { return make_clouds<float>(read::ScalarType::f4, value); };
const auto make_f8 = [](const auto& value) { return make_clouds<double>(read::ScalarType::f8, value); };

read::PointCloudUnits estimate_units(const std::vector<read::PointTable>& clouds) {
    std::vector<double> stamps_s;
    for (std::size_t k = 0; k < clouds.size(); ++k) stamps_s.push_back(kStamp_s + 0.1 * double(k));
    return read::estimate_cloud_units(clouds, stamps_s, 0.1);
}

void expect_sweeps(const std::vector<read::PointTable>& clouds, double time_unit_s) {
    for (const read::PointTable& cloud : clouds) {
        const read::PointFieldView& times = *cloud.find_field(read::PointAttribute::time);
        for (std::size_t i = 0; i < kPoints; ++i)
            EXPECT_NEAR(time_unit_s * (times[i] - times[0]), 1e-4 * double(i), 1e-6);
    }
}

TEST(PointTimes, CountersThatOverflowInACloudContinue) {
    const auto late = [](double unit_s) {
        return [unit_s](double t_s, double k) { return (t_s + 0.1 * k - 0.33) / unit_s; };
    };
    expect_sweeps(make_u4(late(1e-9)), 1e-9);
    expect_sweeps(make_u4(late(1e-6)), 1e-6);
    // The counter of nanoseconds as seconds, and microseconds since the last full hour.
    const auto with_period = [](double unit, double period_s) {
        return
            [=](double t_s, double k) { return unit * std::fmod(t_s + 0.1 * k + period_s - 0.33, period_s); };
    };
    expect_sweeps(make_f8(with_period(1.0, 1e-9 * kCounter)), 1.0);
    expect_sweeps(make_f8(with_period(1e6, 3600.0)), 1e-6);
    for (const double period_s : {1.0, 60.0, 3600.0, 86400.0, 604800.0})
        for (const double unit : {1.0, 1e3, 1e6, 1e9})
            expect_sweeps(make_f8(with_period(unit, period_s)), 1.0 / unit);
    EXPECT_EQ(estimate_units(make_u4(late(1e-9))).time_reference, read::PointTimeReference::sensor_clock);
}

TEST(PointTimes, LateOffsetsAreNoOverflow) {
    for (const double late : {0.9, 59.95, 3599.95}) {
        read::PointTable cloud(kPoints);
        std::vector<double> times;
        for (std::size_t i = 0; i < kPoints; ++i) times.push_back(1e-4 * double(i) + (i < 900 ? 0.0 : late));
        cloud.add_value_field("t", read::ScalarType::f8, times, "test");
        read::unwrap_times(cloud, true);
        for (std::size_t i = 0; i < kPoints; ++i)
            EXPECT_EQ((*cloud.find_field(read::PointAttribute::time))[i], times[i]);
    }
}

TEST(PointTimes, NegativeOffsetsWithoutASignAreRestored) {
    for (const double first_s : {-0.007, -0.1}) {
        std::vector<read::PointTable> clouds =
            make_u4([&](double t_s, double) { return 1e9 * (t_s + first_s); });
        EXPECT_EQ(estimate_units(clouds).time_reference, read::PointTimeReference::stamp);
        for (read::PointTable& cloud : clouds) {
            read::restore_signs(cloud);
            EXPECT_NEAR((*cloud.find_field(read::PointAttribute::time))[0], 1e9 * first_s, 1.0);
        }
        expect_sweeps(clouds, 1e-9);
    }
}

TEST(PointTimes, SomeWrongTimesDoNotChangeTheUnit) {
    const read::PointCloudUnits units =
        estimate_units(make_f4([](double t_s, double) { return t_s < 0.099 ? t_s : 100.0; }));
    EXPECT_EQ(units.time_unit_s, 1.0);
    EXPECT_EQ(units.time_reference, read::PointTimeReference::stamp);
    LidarPoints points;
    points.time_offset_s = {0.0f, 0.05f, 4.288f, 0.1f, NAN, -3.0f, 0.02f};
    points.position_m.resize(7);
    EXPECT_EQ(read::remove_mistimed(points, 0.15), 3u);
    EXPECT_EQ(points.time_offset_s, (std::vector<float>{0.0f, 0.05f, 0.1f, 0.02f}));
    EXPECT_EQ(points.size(), 4u);
    // The whole scan is 3 s late, unlike most other scans.
    std::vector<LidarPoints> scans(5, points);
    for (float& t_s : scans[1].time_offset_s) t_s += 3.0f;
    const std::optional<double> middle_s = read::middle_time_s(scans, 0.15);
    ASSERT_TRUE(middle_s);
    EXPECT_LE(*middle_s, 0.1);
    EXPECT_EQ(read::remove_mistimed(scans[1], 0.15, middle_s), 4u);
    EXPECT_EQ(read::remove_mistimed(scans[0], 0.15, middle_s), 0u);
    for (float& t_s : scans[2].time_offset_s) t_s -= 1.0f;
    for (float& t_s : scans[3].time_offset_s) t_s += 1.0f;
    EXPECT_FALSE(read::middle_time_s(scans, 0.15));  // only two of five agree
}

TEST(PointTimes, OfAClockThatStartsNearZeroAreNoOffsets) {
    using Reference = read::PointTimeReference;
    const auto reference_of = [](const auto& value) { return estimate_units(make_f8(value)).time_reference; };
    const auto recent = [](double t_s, double k) { return 0.3 + 0.1 * k + t_s; };
    EXPECT_EQ(reference_of(recent), Reference::sensor_clock);
    // The clouds are 0.7 s apart.
    const auto within_second = [](double t_s, double k) { return std::fmod(0.7 * k + t_s, 1.0); };
    EXPECT_EQ(reference_of(within_second), Reference::sensor_clock);
    // One late cloud of six does not turn offsets into a clock.
    const auto with_late_cloud = [](double t_s, double k) { return t_s + (k == 2.0 ? 1.5 : 0.0); };
    EXPECT_EQ(reference_of(with_late_cloud), Reference::stamp);
}

TEST(PointTimes, LostPrecisionIsReported) {
    const auto epoch = [](double unit_s) {
        return [=](double t_s, double k) { return (kStamp_s + 0.1 * k + t_s) / unit_s; };
    };
    const auto week = [](double t_s, double k) { return 3e5 + 0.1 * k + t_s; };
    const auto rounded = [&](double t_s, double k) { return double(float(epoch(1.0)(t_s, k))); };
    for (const auto& clouds : {make_f4(epoch(1.0)), make_f4(epoch(1e-3)), make_f4(epoch(1e-9)),
                               make_f8(rounded), make_f4(week), make_u4(epoch(1.0))}) {
        const read::PointCloudUnits units = estimate_units(clouds);
        EXPECT_THAT(units.time_note, testing::HasSubstr("precision"));
        EXPECT_EQ(units.time_reference, read::PointTimeReference::none);
        EXPECT_FALSE(units.is_deskewed);
    }
    for (const double unit_s : {1.0, 1e-3, 1e-6, 1e-9}) {
        const read::PointCloudUnits units = estimate_units(make_f8(epoch(unit_s)));
        EXPECT_EQ(units.time_unit_s, unit_s);
        EXPECT_EQ(units.time_reference, read::PointTimeReference::epoch);
    }
    const auto stamp = [](double, double k) { return kStamp_s + 0.1 * k; };
    const auto half = [](double, double) { return 0.05; };
    for (const auto& clouds : {make_f8(stamp), make_f4(half), make_u4([](double, double) { return 0.0; })})
        EXPECT_TRUE(estimate_units(clouds).is_deskewed);
}

}  // namespace
}  // namespace relidar::bag
