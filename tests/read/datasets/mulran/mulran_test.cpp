// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/scans/stamped_folders.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::MulranFolder;

// Poses are interpolated linearly over 10 ms, and corrections of rays have single
// precision.
constexpr test::StampedTolerance kMulranTolerance{0.002, 0.003, 200.0f / 255.0f};

TEST(Mulran, EveryReturnIsWhereItWasMeasured) {
    const MulranFolder data("KAIST01");
    EXPECT_EQ(detect_kind(data.folder), "mulran");
    const Log log = data.load();
    EXPECT_EQ(log.name, "MulRan KAIST01");
    EXPECT_EQ(log.start_unix_ns, MulranFolder::stamp(0)) << "of the skipped scan";
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_EQ(log.frames[0].index, 1);
    EXPECT_THAT(log.notes,
                testing::Contains(test::Names("1 of 4 scans ... frame 0 ... frame 0 ... global_pose.csv")));
    EXPECT_THAT(log.notes, testing::Contains(test::Names("64 beams ... 1024")));
    const Lidar& lidar = log.lidars[0];
    EXPECT_NEAR(lidar.sensor.period_s, 0.1, 1e-5);
    EXPECT_TRUE(lidar.sensor.clockwise);
    test::expect_elevations(data.drive, lidar.sensor);
    const glm::dvec3 ahead = lidar.vehicle_from_sensor.rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(std::atan2(ahead.y, ahead.x) * 180.0 / kPi, -0.3346, 1e-4) << "looks forward";
    EXPECT_LT(glm::distance(lidar.vehicle_from_sensor.translation, glm::dvec3(1.7042, -0.021, 1.8047)), 1e-9);
    test::expect_truth(data.drive, log, kMulranTolerance);
}

TEST(Mulran, PointsRingByRingInTheOtherFolder) {
    const MulranFolder data("ring-by-ring", false);
    fs::create_directory(data.folder / "sensor_data");
    fs::rename(data.folder / "Ouster", data.folder / "sensor_data/Ouster");
    const Log log = data.load();
    ASSERT_EQ(log.frames.size(), 3u);
    test::expect_truth(data.drive, log, kMulranTolerance);
}

TEST(Mulran, FramesAndOtherPoses) {
    const MulranFolder data("frames");
    const Log one = data.load({.frames = {2, 3}});
    ASSERT_EQ(one.frames.size(), 1u);
    EXPECT_NEAR(one.frames[0].time_s, 0.2, 1e-9) << "after the log's first scan";
    data.expect_error("global_pose.csv ... 0.046 ... 0.356 s", {.frames = {0, 1}});
    EXPECT_EQ(data.load({.poses_file = kNoPoses}).frames.size(), 4u);
    test::write_text(data.folder / "mine.txt",
                     "1 0 0 5 0 1 0 0 0 0 1 0\n1 0 0 6 0 1 0 0 0 0 1 0\n1 0 0 7 0 1 0 0 0 0 1 0\n"
                     "1 0 0 8 0 1 0 0 0 0 1 0\n");
    EXPECT_EQ(data.load({.poses_file = data.folder / "mine.txt"}).world_offset_m, glm::dvec3(7, 0, 0));
}

TEST(Mulran, PosesOfSomethingElseAreTold) {
    const MulranFolder data("backward");
    std::string lines;
    for (int k = -10; k < 40; ++k) {  // sensor that looks to the left
        const Pose pose = data.drive.compute_vehicle_pose(0.01 * k);
        const glm::dvec3 x = pose.rotation * glm::dvec3(0, 1, 0), y = -(pose.rotation * glm::dvec3(1, 0, 0)),
                         &t = pose.translation;
        lines += fmt::format("{},{},{},0,{},{},{},0,{},0,0,1,{}\n", MulranFolder::stamp(0) + k * 10000000ll,
                             x.x, y.x, t.x, x.y, y.y, t.y, t.z);
    }
    test::write_text(data.poses(), lines);
    EXPECT_THAT(data.load().notes, testing::Contains(test::Names("drives ... (-0.00, -1.00, 0.00)")));
}

TEST(Mulran, BrightPointsAreCut) {
    const MulranFolder data("bright");
    std::string bytes = test::read_text(data.scan(1));
    const float bright = 6000.0f;
    bytes.replace(12, 4, reinterpret_cast<const char*>(&bright), 4);
    test::write_text(data.scan(1), bytes);
    const Log log = data.load();
    const auto used = std::ranges::find(log.conventions_used, "intensity", &UsedConvention::name);
    ASSERT_NE(used, log.conventions_used.end());
    EXPECT_EQ(used->value, "0 to 200");
    EXPECT_THAT(used->from, test::Names("6000 ... 99.5th"));
}

TEST(Mulran, SaysWhichFileAndLineIsWrong) {
    const MulranFolder data("errors");
    const auto with = [&](std::size_t line, const std::string& text, const std::string& parts) {
        const std::string good = test::read_text(data.poses());
        std::size_t at = 0;
        for (std::size_t l = 1; l < line; ++l) at = good.find('\n', at) + 1;
        data.expect_error_with(data.poses(), std::string(good).replace(at, good.find('\n', at) - at, text),
                               parts);
    };
    with(2, "1561000444446857630,1,0,0", "global_pose.csv line 2 ... 4 ... 12");
    with(2, "1561000444446857631,1,0,0,0,0,1,0,0,0,0,x,0", "global_pose.csv line 2: cell 12 ... 'x'");
    with(3, "1561000444456857631,2,0,0,0,0,1,0,0,0,0,1,0", "global_pose.csv line 3 ... rotation");
    with(3, "5,1,0,0,0,0,1,0,0,0,0,1,0", "global_pose.csv line 3 ... time 5 ... 1561000444446857630");
    with(3, "x,1,0,0,0,0,1,0,0,0,0,1,0", "global_pose.csv line 3 ... 'x'");
    const std::string bytes = test::read_text(data.scan(2)), first = test::read_text(data.scan(1));
    data.expect_error_with(data.scan(1),
                           std::string(first).erase(16 * 30000, 160) + first.substr(16 * 30000, 160),
                           "degrees ... 1");
    data.expect_error_with(data.scan(2), bytes.substr(0, 1600),
                           fmt::format("{}.bin has 100 points, expected 64 x 1024", MulranFolder::stamp(2)));
    test::write_text(data.scan(2), bytes.substr(0, 1601));
    data.expect_error("1601 ... 16");
    EXPECT_EQ(data.load({.skip_broken = true}).frames.size(), 2u);
    fs::remove(data.poses());
    data.expect_error("global_pose.csv");
    fs::remove_all(data.folder / "Ouster");
    data.expect_error("Ouster/ ... sensor_data/Ouster/");
}

}  // namespace
}  // namespace relidar
