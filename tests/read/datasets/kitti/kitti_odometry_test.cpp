// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstring>

#include <fmt/format.h>

#include "kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// Three frames, 1.5 m apart along the camera's z, which is the LiDAR's x. The camera is
/// 0.3 m ahead of the LiDAR and 0.1 m below it.
struct Odometry : test::LogFolder {
    test::KittiDrive drive;

    explicit Odometry(const std::string& name)
        : LogFolder("relidar_" + name, "sequences/04"), drive(name + "_drive") {
        for (int frame = 0; frame < 3; ++frame) {
            fs::create_directories(folder / "velodyne");
            fs::copy_file(drive.scan(frame), folder / "velodyne" / fmt::format("{:06d}.bin", frame));
        }
        test::write_text(folder / "calib.txt",
                         "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3\n");
        test::write_text(folder / "times.txt", "0.000000e+00\n1.037e-01\n2.074e-01\n");
        test::write_text(poses(),
                         "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1.5\n0.995004165278 0 "
                         "0.099833416647 0 0 1 0 0 -0.099833416647 0 0.995004165278 3\n");
    }
    fs::path poses() const { return folder.parent_path().parent_path() / "poses/04.txt"; }
};

TEST(KittiOdometry, IsRecognisedAndRead) {
    const Odometry odometry("odometry");
    EXPECT_EQ(detect_kind(odometry.folder), "kitti_odometry");
    const Log log = odometry.load();
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_FALSE(log.rolling_shutter);
    EXPECT_EQ(log.frames[1].time_s, 0.1037);
    const std::vector<Pose>& poses = log.world_from_vehicle.pose;
    EXPECT_LT(glm::distance(log.world_offset_m, glm::dvec3(1.5, 0.0, 0.0)), 1e-9);
    EXPECT_LT(glm::distance(poses[0].translation, glm::dvec3(-1.5, 0.0, 0.0)), 1e-9);
    // The camera has turned by 0.1 rad about its y axis. This axis points down, so the
    // camera has turned to the right. The camera is 3 m ahead of its start, and the LiDAR
    // is 0.3 m behind the camera.
    const glm::dvec3 ahead = poses[2].rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(std::atan2(ahead.y, ahead.x), -0.1, 1e-9);
    EXPECT_LT(glm::distance(poses[2].translation,
                            glm::dvec3(-1.5 + 0.3 + 3.0 - 0.3 * std::cos(0.1), 0.3 * std::sin(0.1), 0.0)),
              1e-9);
    EXPECT_EQ(log.frames[0].scan.count_returns(), odometry.drive.n_points);
    EXPECT_EQ(log.lidars[0].sensor.beams.size(), 64u);
    EXPECT_EQ(log.lidars[0].sensor.columns, test::KittiDrive::kFirings);
    EXPECT_EQ(odometry.load({.frames = {1, 3}}).frames.size(), 2u);
}

TEST(KittiOdometry, TakesPosesOfTheLidar) {
    const Odometry odometry("odometry_poses");
    test::write_text(odometry.folder / "lidar.txt",
                     "1 0 0 5 0 1 0 0 0 0 1 0\n1 0 0 6 0 1 0 0 0 0 1 0\n1 0 0 7 0 1 0 0 0 0 1 0\n");
    EXPECT_EQ(odometry.load({.poses_file = odometry.folder / "lidar.txt"}).world_offset_m,
              glm::dvec3(6, 0, 0));
    EXPECT_EQ(odometry.load({.poses_file = kNoPoses}).world_from_vehicle.pose[2].translation,
              glm::dvec3(0, 0, 0));
}

/// Consecutive points have different classes, and instances in the upper 16 bits.
std::vector<std::uint32_t> make_labels(std::size_t n_points) {
    constexpr std::uint32_t kLabels[] = {0, 10, 40, 48, 50, 51, 70, 71, 72, 80, 81, 99, 252, 254, 259};
    std::vector<std::uint32_t> labels;
    for (std::size_t i = 0; i < n_points; ++i)
        labels.push_back(kLabels[i % std::size(kLabels)] | std::uint32_t(i % 1000) << 16);
    return labels;
}

TEST(KittiOdometry, ReadsTheClassesOfSemanticKitti) {
    using enum SurfaceClass;
    constexpr SurfaceClass kClasses[] = {unknown, vehicle,    road,       sidewalk, building,
                                         fence,   vegetation, vegetation, terrain,  pole,
                                         sign,    object,     vehicle,    person,   vehicle};
    const Odometry odometry("odometry_labels");
    for (const int frame : {0, 2}) {
        const std::vector<std::uint32_t> labels = make_labels(fs::file_size(odometry.drive.scan(frame)) / 16);
        test::write_text(odometry.folder / "labels" / fmt::format("{:06d}.label", frame),
                         {reinterpret_cast<const char*>(labels.data()), 4 * labels.size()});
    }
    const Log log = odometry.load();
    EXPECT_TRUE(log.frames[1].scan.classes.empty()) << "a frame without a file";
    for (const int frame : {0, 2}) {
        const std::string bytes = test::read_text(odometry.drive.scan(frame));
        // The scan has coordinates in full millimetres, which identify a point.
        std::map<std::array<long, 3>, SurfaceClass> expected;
        const auto key_of = [](const glm::vec3& p) {
            return std::array{std::lround(1e3 * double(p.x)), std::lround(1e3 * double(p.y)),
                              std::lround(1e3 * double(p.z))};
        };
        for (std::size_t i = 0; i < bytes.size() / 16; ++i) {
            glm::vec4 point;
            std::memcpy(&point, bytes.data() + 16 * i, 16);
            expected[key_of(glm::vec3(point))] = kClasses[i % std::size(kClasses)];
        }
        const Scan& scan = log.frames[std::size_t(frame)].scan;
        ASSERT_EQ(scan.classes.size(), scan.range_m.size());
        for (std::size_t ray = 0; ray < scan.classes.size(); ++ray)
            ASSERT_EQ(scan.classes[ray],
                      scan.range_m[ray] > 0.0f ? expected.at(key_of(scan.return_point(ray))) : unknown);
    }
}

TEST(KittiOdometry, RefusesAnotherNumberOfLabels) {
    const Odometry odometry("odometry_short_labels");
    test::write_text(odometry.folder / "labels/000001.label", "12345678");
    EXPECT_THAT(test::find_load_error(odometry.folder.string()), test::Names("000001.label ... 8"));
}

TEST(KittiOdometry, SaysWhichFileIsWrong) {
    const Odometry odometry("odometry_errors");
    const auto expect = [&](const fs::path& file, const std::string& text, const std::string& part) {
        odometry.expect_error_with(file, text, part);
    };
    expect(odometry.folder / "times.txt", "0\n0.1\n", "times.txt ... 2 ... frame 2 ... 3");
    expect(odometry.folder / "times.txt", "0\nx\n0.2\n", "times.txt line 2 ... 'x' ... time");
    expect(odometry.folder / "times.txt", "0\n0.2\n0.1\n", "frame 2 ... 0.1 s ... 0.2 s");
    expect(odometry.folder / "calib.txt", "P0: 1\n", "calib.txt ... 'Tr:' ... missing");
    expect(odometry.folder / "calib.txt", "Tr: 1 0 0\n", "calib.txt ... Tr ... 3 ... 12");
    expect(odometry.folder / "calib.txt", "Tr: 2 0 0 0 0 1 0 0 0 0 1 0\n", "calib.txt ... rotation");
    fs::remove(odometry.poses());
    expect(odometry.folder / "times.txt", test::read_text(odometry.folder / "times.txt"),
           "dataset.poses=FILE");
}

}  // namespace
}  // namespace relidar
