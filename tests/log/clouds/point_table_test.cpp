// SPDX-License-Identifier: Apache-2.0
// Numbers of point files keep the type of the file, and each scan is read only once.
#include "log/clouds/point_table.hpp"

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

#include "log/clouds/folder_points.hpp"

namespace relidar::folder {
namespace {

template <class T>
void append(std::string& bytes, T value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

/// Two points of 23 bytes: x, y, z, ring, a colour, a time.
PointTable two_points(std::int64_t first_time, std::int64_t second_time) {
    std::string bytes;
    for (const auto& [x, ring, time] : {std::tuple(3.5f, std::uint16_t(7), first_time),
                                        std::tuple(-2.25f, std::uint16_t(300), second_time)}) {
        append(bytes, x), append(bytes, 1.0f), append(bytes, 0.5f);
        append(bytes, ring), append(bytes, std::uint8_t(9)), append(bytes, time);
    }
    const std::vector<PointField> fields = {{"x", 'F', 4},    {"y", 'F', 4},   {"z", 'F', 4},
                                            {"ring", 'U', 2}, {"red", 'U', 1}, {"timestamp", 'I', 8}};
    return read_packed(share_bytes(std::move(bytes)), fields, 2, Packing::by_point, "test");
}

TEST(PointTable, KeepsTheTypeOfTheFile) {
    // a double has 53 bits: it cannot tell these two apart
    constexpr std::int64_t kFirst = (std::int64_t(1) << 53) + 1, kSecond = std::int64_t(1) << 53;
    const PointTable table = two_points(kFirst, kSecond);
    const FieldValues* time = table.find(PointValue::time);
    ASSERT_NE(time, nullptr);
    time->visit([&](const auto& time_at) {
        EXPECT_TRUE((std::is_same_v<decltype(time_at(0)), std::int64_t>));
        EXPECT_EQ(std::int64_t(time_at(0)), kFirst);
        EXPECT_EQ(std::int64_t(time_at(1)), kSecond);
    });
    table.find(PointValue::ring)->visit([](const auto& ring_at) {
        EXPECT_TRUE((std::is_same_v<decltype(ring_at(0)), std::uint16_t>));
        EXPECT_EQ(int(ring_at(1)), 300);
    });
    EXPECT_EQ(table.find(PointValue::intensity), nullptr);
}

TEST(PointTable, CopiesOutliveTheirTable) {
    PointTable copy;
    {
        const PointTable table = two_points(0, 1);
        copy = table;
    }
    EXPECT_EQ((*copy.find(PointValue::x))[1], -2.25);
    copy.remove(PointValue::time);
    EXPECT_EQ(copy.find(PointValue::time), nullptr);
}

TEST(PointTable, NamesOfAValueHaveAnOrder) {
    PointTable table(1);
    table.add("timestamp", NumberType::u4, std::vector<std::uint32_t>{4}, "test");
    table.add("t", NumberType::u4, std::vector<std::uint32_t>{5}, "test");
    EXPECT_EQ((*table.find(PointValue::time))[0], 5.0);
    EXPECT_THROW(table.add("t", NumberType::u4, std::vector<std::uint32_t>{6}, "test"), DataError);
}

/// Cylinders as 8 beams x 90 columns see them. Counts how often each scan is read.
class CountedScans : public ScanSource {
public:
    explicit CountedScans(std::size_t n) : n_reads(n) {}
    std::string name(std::size_t frame) const override { return "scan " + std::to_string(frame); }
    bool has_points(std::size_t) const override { return true; }
    Scan rays(std::size_t) const override { return {}; }
    Points points(std::size_t frame) const override {
        ++n_reads[frame];
        Points points;
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
    Sequence sequence;
    for (std::size_t i = 0; i < kFrames; ++i) add_frame(sequence, int(i), 0.1 * double(i), Pose{});
    Head head;
    head.lidars.emplace_back().lidar = sequence.lidars[0];
    const CountedScans source(kFrames);
    read_scans(sequence, head, source, DatasetOptions{});
    for (std::size_t i = 0; i < kFrames; ++i) {
        EXPECT_EQ(source.n_reads[i], 1) << "scan " << i;
        EXPECT_EQ(sequence.frames[i].scan.count_returns(), 8u * 90u);
    }
}

}  // namespace
}  // namespace relidar::folder
