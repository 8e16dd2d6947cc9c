// SPDX-License-Identifier: Apache-2.0
// Reads the layouts of KITTI tracking and KITTI object. tests/simulate/scan_files has
// tests with the files of `relidar render --layout kitti`.
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include "kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr const char* kNumbersAfterAngles =
    "0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0";  // 30 numbers with the first six
// The camera is 0.3 m ahead of the LiDAR and 0.1 m below it.
constexpr const char* kCameraFromVelo = "0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3";
constexpr const char* kTrackLabel = "Car 0 0 -1.5 0 0 50 50 1.5 1.6 4.0 -2.0 1.7";

/// Three frames of two sequences. The car drives east with 20 m/s. In the LiDAR frame,
/// the labelled car is 2 m to the left, and its distance decreases by 2 m per frame.
struct Tracking : test::LogFolder {
    test::KittiDrive drive;

    explicit Tracking(const std::string& name)
        : LogFolder("relidar_" + name, "training"), drive(name + "_drive") {
        std::string oxts, labels;
        for (int frame = 0; frame < 3; ++frame) {
            const double moved_rad = 2.0 * frame / (6378137.0 * std::cos(49.0 * kPi / 180.0));
            oxts +=
                fmt::format("49 {:.12f} 110 0 0 0 {}\n", 8.4 + moved_rad * 180.0 / kPi, kNumbersAfterAngles);
            labels += fmt::format(
                "{} 7 {} {} -1.47079632679\n{} -1 DontCare -1 -1 -10 0 0 1 1 -1 -1 -1 "
                "-1000 -1000 -1000 -10\n",
                frame, kTrackLabel, 12 - 2 * frame, frame);
            for (const char* sequence : {"0003", "0011"}) {
                fs::create_directories(folder / "velodyne" / sequence);
                fs::copy_file(drive.scan(frame),
                              folder / "velodyne" / sequence / fmt::format("{:06d}.bin", frame));
            }
        }
        test::write_text(labels_file(), labels);
        test::write_text(folder / "oxts/0003.txt", oxts);
        for (const char* sequence : {"0003", "0011"})
            test::write_text(folder / "calib" / (sequence + std::string(".txt")),
                             fmt::format("P0: 1 0 0 0 0 1 0 0 0 0 1 0\nR_rect 1 0 0 0 1 0 0 0 1\n"
                                         "Tr_velo_cam {}\nTr_imu_velo 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.8\n",
                                         kCameraFromVelo));
    }
    fs::path labels_file() const { return folder / "label_02/0003.txt"; }
};

TEST(KittiTracking, PosesBoxesAndPoints) {
    const Tracking tracking("tracking");
    EXPECT_EQ(detect_kind(tracking.folder), "kitti_tracking");
    EXPECT_EQ(detect_kind(tracking.folder.parent_path()), "kitti_tracking");
    const Log log = tracking.load();
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_TRUE(log.has_poses);
    EXPECT_TRUE(log.rolling_shutter) << "the points of an HDL-64E were not moved";
    EXPECT_NEAR(log.frames[2].time_s, 0.2, 1e-12);
    const std::vector<Pose>& poses = log.world_from_vehicle.pose;
    // The IMU is 0.8 m behind the LiDAR's origin, 0.3 m left of it and 0.8 m below it.
    for (int frame = 0; frame < 3; ++frame)
        EXPECT_LT(glm::distance(poses[std::size_t(frame)].translation + log.world_offset_m,
                                glm::dvec3(2.0 * frame + 0.8, -0.3, 0.8)),
                  1e-6);
    ASSERT_TRUE(log.georeference);
    EXPECT_NEAR(log.georeference->position.longitude_deg, 8.4, 1e-12);
    EXPECT_EQ(log.frames[0].scan.count_returns(), tracking.drive.n_points);
    EXPECT_EQ(log.lidars[0].sensor.columns, test::KittiDrive::kFirings);

    ASSERT_EQ(log.boxes.size(), 1u);
    const BoxTrack& car = log.boxes[0];
    EXPECT_EQ(car.id, "7");
    EXPECT_EQ(car.category, "Car");
    EXPECT_LT(glm::distance(car.size_m, glm::dvec3(4.0, 1.6, 1.5)), 1e-12);
    for (int frame = 0; frame < 3; ++frame) {
        const Pose velo_from_box =
            inverse(poses[std::size_t(frame)]) * car.world_from_box.pose[std::size_t(frame)];
        // z: 1.7 m below the camera, which is 0.1 m below the LiDAR; half of 1.5 m above
        EXPECT_LT(glm::distance(velo_from_box.translation, glm::dvec3(12.3 - 2 * frame, 2.0, -1.05)), 1e-6);
        const glm::dvec3 forward = velo_from_box.rotation * glm::dvec3(1, 0, 0);
        EXPECT_NEAR(std::atan2(forward.y, forward.x), -0.1, 1e-9);
    }
}

TEST(KittiTracking, SequencesAndMissingFiles) {
    const Tracking tracking("tracking_other");
    for (const char* name : {"0011", "11"}) {
        const Log log = tracking.load({.sequence = name});
        EXPECT_EQ(log.name, "KITTI tracking 0011");
        EXPECT_FALSE(log.has_poses);
        EXPECT_TRUE(log.boxes.empty());
    }
    EXPECT_EQ(tracking.load().name, "KITTI tracking 0003");
    EXPECT_EQ(tracking.load({.frames = {1, 3}}).boxes[0].world_from_box.pose.size(), 2u);
    tracking.expect_error("dataset.sequence ... '12' ... 0003, 0011", {.sequence = "12"});
    const auto expect = [&](const fs::path& file, const std::string& text, const std::string& part) {
        tracking.expect_error_with(file, text, part);
    };
    expect(tracking.labels_file(), "0 7 Car 0 0\n", "0003.txt line 1 ... '0 7 Car 0 0' ... 14");
    expect(tracking.labels_file(), fmt::format("0 7 {} inf 0\n", kTrackLabel), "0003.txt line 1 ... finite");
    expect(tracking.folder / "calib/0003.txt", "R_rect 1 0 0 0 1 0 0 0 1\n", "0003.txt ... 'Tr_imu_velo'");
    expect(tracking.folder / "oxts/0003.txt", "1 2 3\n", "oxts/0003.txt line 1 ... 3 ... 30");
}

/// Returns the pose of a camera that looks along x of the world, as View-of-Delft stores
/// it.
std::string camera_pose_json(double x_m) {
    return fmt::format(
        "{{\"odomToCamera\": [0, 0, 1, {}, -1, 0, 0, 0.0, 0, -1, 0, 1.5, 0, 0, 0, 1]}}\n"
        "{{\"mapToCamera\": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}\n",
        x_m);
}

TEST(KittiObject, PosesOfViewOfDelft) {
    const test::LogFolder object("relidar_object", "lidar/training");
    const test::KittiDrive drive("object_drive");
    for (int frame = 0; frame < 3; ++frame) {
        const std::string name = fmt::format("{:05d}", 549 + frame);
        fs::create_directories(object.folder / "velodyne");
        fs::copy_file(drive.scan(frame), object.folder / "velodyne" / (name + ".bin"));
        test::write_text(object.folder / "label_2" / (name + ".txt"),
                         fmt::format("{} 12 0 1\n", kTrackLabel));
        test::write_text(object.folder / "calib" / (name + ".txt"),
                         fmt::format("R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {}\nTr_imu_to_velo:\n",
                                     kCameraFromVelo));
        test::write_text(object.folder / "pose" / (name + ".json"), camera_pose_json(1.5 * frame));
    }
    EXPECT_EQ(detect_kind(object.folder), "kitti_object");
    const Log log = load_log(object.folder.parent_path().parent_path().string(), {});
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_EQ(log.frames[0].index, 549);
    EXPECT_TRUE(log.has_poses);
    EXPECT_TRUE(log.boxes.empty()) << "labels have no track ids";
    for (int frame = 0; frame < 3; ++frame)
        // The LiDAR is 0.3 m behind the camera and 0.1 m above it.
        EXPECT_LT(
            glm::distance(log.world_from_vehicle.pose[std::size_t(frame)].translation + log.world_offset_m,
                          glm::dvec3(1.5 * frame - 0.3, 0.0, 1.6)),
            1e-9);
    object.expect_error_with(object.folder / "pose/00550.json", "{}", "00550.json ... odomToCamera");
    fs::remove_all(object.folder / "pose");
    const Log without = object.load();
    EXPECT_FALSE(without.has_poses);
    EXPECT_EQ(without.frames[0].scan.count_returns(), drive.n_points);
}

}  // namespace
}  // namespace relidar
