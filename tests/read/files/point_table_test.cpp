// SPDX-License-Identifier: Apache-2.0
#include "read/files/point_table.hpp"

#include <atomic>

#include <gtest/gtest.h>

#include "base/bytes.hpp"
#include "read/files/dropped_ray.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/point_meaning.hpp"
#include "support/names.hpp"

namespace relidar::read {
namespace {

/// Makes a table of two points with 23 bytes each: x, y, z, ring, a colour, a time.
PointTable make_two_points(std::int64_t first_time, std::int64_t second_time) {
    std::string bytes;
    for (const auto& [x, ring, time] : {std::tuple(3.5f, std::uint16_t(7), first_time),
                                        std::tuple(-2.25f, std::uint16_t(300), second_time)}) {
        append_raw(bytes, x);
        append_raw(bytes, 1.0f);
        append_raw(bytes, 0.5f);
        append_raw(bytes, ring);
        append_raw(bytes, std::uint8_t(9));
        append_raw(bytes, time);
    }
    const std::vector<PointField> fields = {{"x", 'F', 4},    {"y", 'F', 4},   {"z", 'F', 4},
                                            {"ring", 'U', 2}, {"red", 'U', 1}, {"timestamp", 'I', 8}};
    return table_of_records(share_bytes(std::move(bytes)), fields, 2, PointMemoryLayout::by_point, "test");
}

TEST(PointTable, KeepsTheTypeOfTheFile) {
    // two integers that are equal as doubles, because a double has 53 bits
    constexpr std::int64_t kFirst = (std::int64_t(1) << 53) + 1, kSecond = std::int64_t(1) << 53;
    const PointTable table = make_two_points(kFirst, kSecond);
    const PointFieldView* time = table.find_field(PointAttribute::time);
    ASSERT_NE(time, nullptr);
    time->with_reader([&](const auto& time_at) {
        EXPECT_TRUE((std::is_same_v<decltype(time_at(0)), std::int64_t>));
        EXPECT_EQ(std::int64_t(time_at(0)), kFirst);
        EXPECT_EQ(std::int64_t(time_at(1)), kSecond);
    });
    table.find_field(PointAttribute::ring)->with_reader([](const auto& ring_at) {
        EXPECT_TRUE((std::is_same_v<decltype(ring_at(0)), std::uint16_t>));
        EXPECT_EQ(int(ring_at(1)), 300);
    });
    EXPECT_EQ(table.find_field(PointAttribute::intensity), nullptr);
}

TEST(PointTable, CopiesOutliveTheirTable) {
    PointTable copy;
    {
        const PointTable table = make_two_points(0, 1);
        copy = table;
    }
    EXPECT_EQ((*copy.find_field(PointAttribute::x))[1], -2.25);
    copy.remove_fields(PointAttribute::time);
    EXPECT_EQ(copy.find_field(PointAttribute::time), nullptr);
}

TEST(PointTable, TextWithFewerPointsThanItsCountIsCut) {
    const auto parse = [](const char* text) { return parse_text(share_bytes(text), {}, "test").n; };
    EXPECT_EQ(parse("2\n1 2 3\n4 5 6\n"), 2u);
    EXPECT_THROW(parse("3\n1 2 3\n4 5 6\n"), DataError);
}

TEST(PointTable, NamesOfAValueHaveAnOrder) {
    PointTable table(1);
    table.add_value_field("timestamp", ScalarType::u4, std::vector<std::uint32_t>{4}, "test");
    table.add_value_field("t", ScalarType::u4, std::vector<std::uint32_t>{5}, "test");
    EXPECT_EQ((*table.find_field(PointAttribute::time))[0], 5.0);
    EXPECT_THROW(table.add_value_field("t", ScalarType::u4, std::vector<std::uint32_t>{6}, "test"),
                 DataError);
}

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinite = std::numeric_limits<float>::infinity();

PointTable to_point_table(const std::vector<glm::vec3>& points,
                          const std::vector<std::pair<std::string, std::vector<float>>>& fields) {
    PointTable table(points.size());
    for (int axis = 0; axis < 3; ++axis) {
        std::vector<float> values;
        for (const glm::vec3& p : points) values.push_back(p[axis]);
        table.add_value_field(std::string(1, char('x' + axis)), ScalarType::f4, std::move(values), "test");
    }
    for (const auto& [name, values] : fields) table.add_value_field(name, ScalarType::f4, values, "test");
    return table;
}

std::vector<glm::vec3> make_measured_points(std::size_t count) {
    std::vector<glm::vec3> points;
    for (std::size_t i = 0; i < count; ++i) {
        const double azimuth = 0.01 * double(i), range_m = 20.0 + 15.0 * std::sin(0.37 * double(i));
        points.emplace_back(range_m * std::cos(azimuth), range_m * std::sin(azimuth), 0.001 * double(i % 97));
    }
    return points;
}

TEST(DroppedRays, HaveManySpellings) {
    const glm::vec3 real(3.0f, -4.0f, 1.0f);
    const std::vector<glm::vec3> dropped = {{kNan, kNan, kNan},
                                            {kInfinite, kInfinite, kInfinite},
                                            {-kInfinite, -kInfinite, -kInfinite},
                                            {0.0f, -0.0f, 0.0f},
                                            {kNan, 1.0f, 2.0f},
                                            {1.0f, kNan, 2.0f},
                                            {1.0f, 2.0f, kNan},
                                            {5.0f, kInfinite, 0.0f},
                                            {1e-5f, 0.0f, 1e-5f}};
    std::vector<glm::vec3> points;
    for (const glm::vec3& p : dropped) {
        points.push_back(p);
        points.push_back(real);
    }
    const LidarPoints returns = convert_table(to_point_table(points, {}), PointFileUnits{}, 0.0, "test");
    ASSERT_EQ(returns.size(), dropped.size());
    for (const glm::vec3& p : returns.position_m) EXPECT_EQ(p, real);
}

TEST(DroppedRays, HaveRangeZeroInARangeField) {
    const std::vector<glm::vec3> points = make_measured_points(4);
    const auto n_returns = [&](const std::vector<float>& range) {
        return convert_table(to_point_table(points, {{"range", range}}), PointFileUnits{}, 0.0, "test")
            .size();
    };
    for (const float unit : {1.0f, 1000.0f}) {  // metres, millimetres
        const float first = unit * glm::length(points[0]), last = unit * glm::length(points[3]);
        EXPECT_EQ(n_returns({first, 0.0f, kInfinite, last}), 2u);
        EXPECT_EQ(n_returns({-first, 0.0f, 0.3f * last, last}), 4u)
            << "a signed distance from something else";
    }
    EXPECT_EQ(n_returns({0.0f, 0.0f, 0.0f, 0.0f}), 4u) << "a field that no program has filled";
}

TEST(DroppedRays, HaveAPositionThatIsRepeated) {
    std::vector<glm::vec3> points = make_measured_points(2000);
    EXPECT_EQ(interpret_fields({to_point_table(points, {})}).no_return, std::nullopt);
    // Rays without a return are points at the sensor, transformed to its mounting
    // position.
    const glm::vec3 mounting(1.2f, 0.0f, 1.7f);
    for (std::size_t i = 0; i < points.size(); i += 20) points[i] = mounting;
    PointFileUnits units;
    units.no_return = interpret_fields({to_point_table(points, {})}).no_return;
    EXPECT_EQ(units.no_return, mounting);
    EXPECT_EQ(convert_table(to_point_table(points, {}), units, 0.0, "test").size(), 1900u);
}

TEST(DroppedRays, MarkTheMaximumRangeOfTheSensor) {
    const auto n_returns = [](float marker_m) {
        Log log;
        add_frame(log, 0, 0.0, Pose{});
        Scan& scan = log.frames[0].scan;
        scan = scan_of_points(LidarPoints{make_measured_points(2000), std::vector<float>(2000, 0.5f)});
        for (std::size_t i = 0; i < 2000; ++i) {
            scan.rays.channel[i] = std::uint16_t(i % 16);
            if (i % 10 == 0) scan.range_m[i] = marker_m * (1.0f + 1e-7f * float(i % 3));
        }
        remove_drop_markers(log);
        return scan.count_returns();
    };
    EXPECT_EQ(n_returns(100.0f), 1800u);
    EXPECT_EQ(n_returns(130.5f), 1800u);
    EXPECT_EQ(n_returns(99.87f), 2000u) << "a wall";
}

TEST(PointTable, FindsFieldsByTheirMeaning) {
    for (const char* name : {"intensity", "Intensity", "INTENSITY", "scalar_intensity", "scalar_Intensity",
                             "i", "intensities", "reflectance", "remission", "signal", "amplitude"})
        EXPECT_EQ(find_attribute(name), PointAttribute::intensity) << name;
    for (const char* name : {"x", "X", "scalar_x", "point_x", "pos_X", "position.x", "//X"})
        EXPECT_EQ(find_attribute(name), PointAttribute::x) << name;
    for (const char* name : {"nx", "normal_x", "velocity_x", "vx", "x_origin", "rgb", "ambient", "in", ""})
        EXPECT_EQ(find_attribute(name), std::nullopt) << name;
    const std::vector<glm::vec3> points = make_measured_points(3);
    const PointTable table = to_point_table(points, {{"scalar_x", {7.0f, 7.0f, 7.0f}}});
    EXPECT_EQ((*table.find_field(PointAttribute::x))[1], double(points[1].x));
}

TEST(PointMeaning, UsesIntensitiesThatAreNotZero) {
    const std::vector<glm::vec3> points = make_measured_points(3);
    const std::vector<float> zero(3, 0.0f), bright = {12.0f, 187.0f, 3.0f};
    const PointFieldSemantics meaning =
        interpret_fields({to_point_table(points, {{"intensity", zero}, {"reflectivity", bright}})});
    EXPECT_EQ(meaning.intensity_field, "reflectivity");
    EXPECT_EQ(meaning.scale.max, 255.0);
    PointFileUnits units;
    units.intensity_field = meaning.intensity_field;
    units.intensity_max = meaning.scale.max;
    const PointTable table = to_point_table(points, {{"intensity", zero}, {"reflectivity", bright}});
    EXPECT_FLOAT_EQ(convert_table(table, units, 0.0, "test").intensity[1], 187.0f / 255.0f);
    EXPECT_EQ(interpret_fields({to_point_table(points, {{"intensity", zero}})}).notes.size(), 1u);
    EXPECT_TRUE(interpret_fields({to_point_table(points, {{"intensity", bright}})}).notes.empty());
}

TEST(PointMeaning, FindsTheScaleOfIntensities) {
    EXPECT_EQ(estimate_scale({0.0, 0.2, 1.0}).max, 1.0);
    EXPECT_EQ(estimate_scale({0.0, 12.0, 187.0}).max, 255.0);
    EXPECT_TRUE(estimate_scale({0.0, 12.0, 187.0}).is_sure);
    EXPECT_FALSE(estimate_scale({0.0, 12.0, 100.0}).is_sure) << "may be percent";
    EXPECT_FALSE(estimate_scale({-1.0, 12.0, 187.0}).is_sure);
    EXPECT_TRUE(estimate_scale({0.0, 12.0, 4000.0}).is_sure);
    EXPECT_FALSE(estimate_scale({0.0, 12.0, 70000.0}).is_sure) << "more than 16 bits";
}

/// The scans show a cylinder with 8 beams x 90 columns.
class CountedScans : public ScanProvider {
public:
    explicit CountedScans(std::size_t count) : n_reads(count) {}
    std::string frame_name(std::size_t frame) const override { return "scan " + std::to_string(frame); }
    LidarPoints read_points(std::size_t frame) const override {
        ++n_reads[frame];
        LidarPoints points;
        for (std::uint16_t beam = 0; beam < 8; ++beam)
            for (int column = 0; column < 90; ++column) {
                const double azimuth = kPi - (column + 0.5) * 2.0 * kPi / 90;
                points.position_m.emplace_back(10.0 * std::cos(azimuth), 10.0 * std::sin(azimuth),
                                               1.0 - 0.3 * beam);
                points.intensity.push_back(0.5f);
                points.ring.push_back(beam);
            }
        return points;
    }
    mutable std::vector<std::atomic<int>> n_reads;
};

TEST(ReadScans, ReadsEachScanOnce) {
    constexpr std::size_t kFrames = 9;  // more than are looked at to find the sensor
    Log log;
    for (std::size_t i = 0; i < kFrames; ++i) add_frame(log, int(i), 0.1 * double(i), Pose{});
    const CountedScans source(kFrames);
    read_scans(log, {.lidars = {{}}}, source, DatasetOptions{});
    for (std::size_t i = 0; i < kFrames; ++i) {
        EXPECT_EQ(source.n_reads[i], 1) << "scan " << i;
        EXPECT_EQ(log.frames[i].scan.count_returns(), 8u * 90u);
    }
}

/// Returns a cloud of 1000 rays. Rays with two returns are `step_rad` wide.
PointTable make_pairs(double share, double step_rad) {
    std::vector<float> x, y, z, t;
    for (int i = 0; i < 1000; ++i)
        for (int k = 0; k < (i % 100 < 100.0 * share ? 2 : 1); ++k) {
            const double azimuth_rad = 0.006 * i + step_rad * k, range_m = 10.0 + 0.01 * (i % 37) + 2.0 * k;
            x.push_back(float(range_m * std::cos(azimuth_rad)));
            y.push_back(float(range_m * std::sin(azimuth_rad)));
            z.push_back(float(-0.1 * range_m));
            t.push_back(1e-4f * float(i));
        }
    PointTable cloud(x.size());
    for (const auto& [name, values] :
         {std::pair("x", x), std::pair("y", y), std::pair("z", z), std::pair("time", t)})
        cloud.add_value_field(name, ScalarType::f4, values, "test");
    cloud.add_value_field("ring", ScalarType::u2, std::vector<std::uint16_t>(x.size(), 3), "test");
    return cloud;
}

TEST(PointTable, WrongReturnNumbersAreThoseOfTheFile) {
    PointTable cloud = make_pairs(0.0, 0.0);
    std::vector<std::uint8_t> numbers(cloud.n, 1);
    numbers[7] = 9;
    cloud.add_value_field("return_number", ScalarType::u1, numbers, "test");
    EXPECT_THAT([&] { convert_table(cloud, {}, 0.0, "test"); },
                testing::ThrowsMessage<DataError>(test::Names("point 7 ... 9 ... 1 ... 8")));
}

TEST(PointTable, FrequentAndRareSecondReturnsAreFound) {
    for (const double share : {0.1, 0.6, 0.95, 1.0}) {
        EXPECT_TRUE(find_unnumbered({make_pairs(share, 0.0)}).exist) << share;
        EXPECT_TRUE(interpret_fields({make_pairs(0.0, 0.0), make_pairs(share, 0.0)}).returns.exist);
        EXPECT_FALSE(find_unnumbered({make_pairs(share, 0.0035)}).exist);  // two columns of one time
    }
    const PointTable rare = make_pairs(0.01, 0.0);  // ten pairs: too few in one cloud
    EXPECT_FALSE(find_unnumbered({rare}).exist);
    EXPECT_TRUE(find_unnumbered({rare, make_pairs(0.0, 0.0), rare}).exist);
    EXPECT_FALSE(find_unnumbered({PointTable(0)}).exist);  // no point contradicts pairs
}

}  // namespace
}  // namespace relidar::read
