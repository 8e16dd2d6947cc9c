// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/files/point_writers.hpp"

namespace relidar {
namespace {

using test::Names;
using testing::Contains;
using testing::ThrowsMessage;

constexpr int kColumns = 36, kScans = 2;
constexpr double kElevation_deg[] = {5.0, -5.0};

/// Two scans of a wall at 20 m. Each has a return at 149.25 m and a return at 0.4 m.
class RangeLimit : public testing::Test {
protected:
    const test::LogFolder files{"relidar_range_limit"};

    void SetUp() override {
        for (int i = 0; i < kScans; ++i)
            test::write_text(files.folder / fmt::format("scans/{}.bin", i), test::bin(wall(i)));
        test::write_text(files.folder / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
    }

    static test::FilePoints wall(int scan) {
        test::FilePoints points;
        for (std::uint16_t ring = 0; ring < 2; ++ring)
            for (int k = 0; k < kColumns; ++k) {
                const double azimuth = kPi * (1.0 - (2.0 * k + 1.0) / kColumns),
                             elevation = kElevation_deg[ring] * kPi / 180.0;
                const bool is_far = ring == 0 && k == 5 + scan, is_near = ring == 1 && k == 11 + scan;
                double range_m = 20.0;
                if (is_far) range_m = 149.25;
                else if (is_near) range_m = 0.4;
                points.push_back({glm::vec3(range_m * glm::dvec3(std::cos(elevation) * std::cos(azimuth),
                                                                 std::cos(elevation) * std::sin(azimuth),
                                                                 std::sin(elevation))),
                                  0.5f, ring, 0.1 * scan});
            }
        return points;
    }
    /// @param names, values additional columns of the sensor's beam table
    Log load(const std::string& names, const std::string& values,
             const DatasetOptions& options = {.max_range_m = INFINITY}) const {
        test::write_text(files.folder / "beams.csv",
                         fmt::format("elevation_deg{0}\n5{1}\n-5{1}\n", names, values));
        test::write_text(files.folder / "sequence.json",
                         fmt::format(R"({{"format": "relidar log", "version": 1, "rate_hz": 10,
            "columns": ["x", "y", "z", "intensity", "ring"], "lidars": [{{"sensor": "beams.csv:{}x10"}}]}})",
                                     kColumns));
        return files.load(options);
    }
    static std::size_t count_returns(const Log& log) {
        std::size_t n = 0;
        for (const Frame& frame : log.frames) n += frame.scan.count_returns();
        return n;
    }
};

TEST_F(RangeLimit, OfATableWithoutOneIsTheFarthestReturn) {
    const Log log = load("", "");
    EXPECT_EQ(log.lidars[0].sensor.max_range_m, 150.0);
    EXPECT_EQ(count_returns(log), std::size_t(2 * kColumns * kScans)) << "no return is lost";
    EXPECT_THAT(log.notes, Contains(Names("farthest ... 150 m")));
    EXPECT_THAT(log.notes, testing::Not(Contains(Names("dropped"))));
}

TEST_F(RangeLimit, OfATableCountsTheReturnsThatItExcludes) {
    const Log far = load(",max_range_m", ",100");
    EXPECT_EQ(far.lidars[0].sensor.max_range_m, 100.0);
    EXPECT_EQ(count_returns(far), std::size_t(2 * kColumns * kScans - 2));
    EXPECT_THAT(far.notes, Contains(Names("2 of 144 ... 1.39 % ... 2 ... 100 m")));
    const Log both = load(",min_range_m,max_range_m", ",1,100");
    EXPECT_THAT(both.notes, Contains(Names("4 of 144 ... 2.78 % ... 2 ... 100 m ... 2 ... 1 m")));
}

TEST_F(RangeLimit, OfTheUserCountsTheReturnsThatItExcludes) {
    EXPECT_THAT(load("", "", {.max_range_m = 30.0}).notes,
                Contains(Names("2 of 144 ... 1.39 % ... 2 ... 30 m")));
    EXPECT_THAT([&] { load("", "", {.max_range_m = 10.0, .min_range_m = 1.0}); },
                ThrowsMessage<DataError>(Names("144 returns")));
    // The minimum of the user is above the maximum of the sensor.
    EXPECT_THAT([&] { load(",max_range_m", ",10", {.max_range_m = INFINITY, .min_range_m = 50.0}); },
                ThrowsMessage<UsageError>(Names("50 m ... 10 m")));
    EXPECT_THROW(load("", "", {.max_range_m = 20.0, .min_range_m = 20.0}), UsageError);
}

}  // namespace
}  // namespace relidar
