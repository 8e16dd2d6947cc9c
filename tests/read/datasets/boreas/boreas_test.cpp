// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/scans/stamped_folders.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::BoreasFolder;

// Poses are interpolated linearly between scans. At 8 m/s and 0.3 rad/s the error is 9 mm
// at half a scan before the first pose.
constexpr test::StampedTolerance kBoreasTolerance{0.01, 0.011, 0.2f};

TEST(Boreas, EveryReturnIsWhereItWasMeasured) {
    const BoreasFolder data("2020-11-26-13-58");
    EXPECT_EQ(detect_kind(data.folder), "boreas");
    const Log log = data.load();
    EXPECT_EQ(log.name, "boreas-2020-11-26-13-58");
    EXPECT_THAT(log.conventions, test::Names("-42.60 degrees"));
    EXPECT_EQ(log.start_unix_ns, 1000 * BoreasFolder::stamp(0));
    EXPECT_THAT(log.notes, testing::ElementsAre(test::Names("labels"), test::Names("128 beams ... 360"),
                                                test::Names("intensities ... 0.2")));
    ASSERT_EQ(log.frames.size(), std::size_t(BoreasFolder::kScans));
    const SpinningSensor& sensor = log.lidars[0].sensor;
    EXPECT_NEAR(sensor.period_s, 0.1, 1e-5);
    EXPECT_TRUE(sensor.clockwise);
    test::expect_elevations(data.drive, sensor);
    test::expect_truth(data.drive, log, kBoreasTolerance);
    for (std::size_t i = 0; i < log.frames.size(); ++i) {  // x points forward
        const glm::dvec3 ahead = log.world_from_vehicle.pose[i].rotation * glm::dvec3(1, 0, 0);
        const glm::dvec3 truth =
            data.drive.compute_vehicle_pose(0.1 * double(i)).rotation * glm::dvec3(1, 0, 0);
        EXPECT_LT(glm::distance(ahead, truth), 1e-6);
    }
}

TEST(Boreas, AnglesThatOthersWouldWrite) {
    const char* names[] = {"", "R_z(yaw) R_y(pitch) R_x(roll)", "R_z(-yaw) R_y(-pitch) R_x(-roll)",
                           "R_x(roll) R_y(pitch) R_z(yaw)"};
    for (const int angles : {1, 2, 3}) {
        const BoreasFolder data("angles", angles);
        for (const bool calibrated : {true, false}) {
            if (!calibrated) fs::remove(data.calibration());
            const Log log = data.load();
            EXPECT_THAT(log.notes,
                        testing::Contains(test::Names(std::string("angles ... ") + names[angles])));
            test::expect_truth(data.drive, log, kBoreasTolerance);
        }
    }
}

TEST(Boreas, WithoutCalibrationForwardIsWhereItDrives) {
    const BoreasFolder data("uncalibrated");
    fs::remove(data.calibration());
    const Log log = data.load();
    test::expect_truth(data.drive, log, kBoreasTolerance);
    const glm::dvec3 ahead = log.world_from_vehicle.pose[0].rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(std::atan2(ahead.y, ahead.x), data.drive.heading_rad, 0.01);
}

TEST(Boreas, FramesAndOtherPoses) {
    const BoreasFolder data("frames");
    const Log some = data.load({.frames = {2, 4}});
    ASSERT_EQ(some.frames.size(), 2u);
    EXPECT_EQ(some.frames[0].index, 2);
    EXPECT_NEAR(some.frames[0].time_s, 0.2, 1e-9) << "after the log's first scan";
    data.expect_error("frames 6:9 ... boreas-frames ... [0, 5]", {.frames = {6, 9}});
    fs::remove(data.poses());
    const Log none = data.load({.poses_file = kNoPoses});
    EXPECT_EQ(none.frames.size(), std::size_t(BoreasFolder::kScans));
    EXPECT_EQ(none.world_from_vehicle.pose[5].translation, glm::dvec3(0.0));
    EXPECT_THAT(none.notes, testing::Contains(test::Names("poses ... read")));
}

TEST(Boreas, ScansWithoutPosesAreLeftOut) {
    const BoreasFolder data("gap");
    const std::string good = test::read_text(data.poses());
    const auto without = [&](int first, int last) {
        std::string text = good;
        for (int s = first; s <= last; ++s) {
            const std::size_t at = text.find(std::to_string(BoreasFolder::stamp(s)));
            text.erase(at, text.find('\n', at) + 1 - at);
        }
        test::write_text(data.poses(), text);
    };
    without(0, 1);
    const Log log = data.load();
    ASSERT_EQ(log.frames.size(), 4u);
    EXPECT_EQ(log.frames[0].index, 2);
    EXPECT_THAT(log.notes,
                testing::Contains(test::Names("2 of 6 scans ... frame 0 ... frame 1 ... lidar_poses.csv")));
    data.expect_error("lidar_poses.csv ... 0.200 ... 39.900 s ... 0.000 ... 0.100 s", {.frames = {0, 2}});
    without(2, 3);  // 0.3 s between two poses
    EXPECT_EQ(data.load().frames.size(), 6u);
}

TEST(Boreas, SaysWhichFileAndLineIsWrong) {
    const BoreasFolder data("errors");
    const auto with = [&](const fs::path& file, int line, const std::string& from, const std::string& to,
                          const std::string& parts) {
        const std::string text = test::read_text(file);
        std::size_t at = 0;
        for (int l = 1; l < line; ++l) at = text.find('\n', at) + 1;
        data.expect_error_with(file, text.substr(0, at) + test::replace_first(text.substr(at), from, to),
                               parts);
    };
    with(data.poses(), 3, ",0.0,0.0\n", "\n", "lidar_poses.csv line 3 ... 11 ... 12");
    with(data.poses(), 4, ",0.3,", ",x,", "lidar_poses.csv line 4: cell 11 ... 'x' ... 1e+08");
    with(data.poses(), 4, ",0.3,", ",nan,", "lidar_poses.csv line 4: cell 11 ... 'nan'");
    with(data.poses(), 4, "16064", "t6064", "lidar_poses.csv line 4 ... 't606417097728152'");
    with(data.poses(), 5, "16064", "16063",
         "lidar_poses.csv line 5 ... time 1606317097828152 ... 1606417097728152");
    const std::string poses = test::read_text(data.poses()), scan = test::read_text(data.scan(3));
    data.expect_error_with(data.poses(), poses.substr(0, poses.find('\n') + 1), "lidar_poses.csv ... pose");
    with(data.calibration(), 1, " ", " x", "T_applanix_lidar.txt ... 4 ... 4");
    with(data.calibration(), 4, "0 0 0 1", "", "T_applanix_lidar.txt ... 12");
    with(data.calibration(), 1, "0.", "3.", "T_applanix_lidar.txt ... rotation");
    data.expect_error_with(data.scan(3), scan.substr(0, scan.size() - 5), ".bin: ");
    data.expect_error_with(data.scan(3), "", "0 points");
    test::write_text(data.scan(3), "cut");
    EXPECT_EQ(data.load({.skip_broken = true}).frames.size(), 5u);
    data.expect_error("1606417097828152.bin ... 3 ... 24");
    fs::remove(data.poses());
    data.expect_error("lidar_poses.csv ... dataset.poses=FILE");
    fs::remove_all(data.folder / "lidar");
    fs::create_directory(data.folder / "lidar");
    data.expect_error("scan");
}

}  // namespace
}  // namespace relidar
