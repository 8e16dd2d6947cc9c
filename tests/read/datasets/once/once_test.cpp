// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstring>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/scans/stamped_folders.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::OnceFolder;

void expect_once_truth(const OnceFolder& data, const Log& log) {
    const PoseTrack track = log.lidar_track(0);
    const Pose yard_from_once{data.drive.compute_lidar_pose_at(0.0)};
    for (const Frame& frame : log.frames) {
        EXPECT_NEAR(frame.time_s, frame.index * 0.5, 1e-9);
        EXPECT_EQ(frame.scan.count_returns(), data.drive.count_returns(frame.index));
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const auto [origin_m, point_m] = test::place_return(log, track, frame, i);
            const double fired_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            // Poses are interpolated linearly over half a second. At 8 m/s and 0.1 rad/s
            // the error is 14 mm at half a scan before the first pose.
            ASSERT_LT(glm::distance(yard_from_once * origin_m,
                                    data.drive.compute_lidar_pose_at(fired_s).translation),
                      0.015)
                << frame.index << " " << i;
            ASSERT_LT(test::measure_distance_to_yard_m(yard_from_once * point_m - data.drive.world_m), 0.02)
                << frame.index << " " << i;
            ASSERT_FLOAT_EQ(frame.scan.intensity[i], 0.25f);
        }
    }
}

TEST(Once, EveryReturnIsOnTheYard) {
    const OnceFolder data("000076");
    EXPECT_EQ(detect_kind(data.folder), "once");
    const Log log = data.load();
    EXPECT_EQ(log.start_unix_ns, 1000000 * OnceFolder::stamp(0));
    EXPECT_EQ(log.name, "ONCE 000076");
    ASSERT_EQ(log.frames.size(), std::size_t(OnceFolder::kScans));
    EXPECT_THAT(log.notes, testing::Contains(test::Names("1 boxes ... 1")));
    EXPECT_THAT(log.notes, testing::Contains(test::Names("40 beams ... 900")));
    EXPECT_TRUE(log.boxes.empty());
    const SpinningSensor& sensor = log.lidars[0].sensor;
    EXPECT_EQ(sensor.period_s, 0.1) << "a turn, not the time between scans";
    test::expect_elevations(data.drive, sensor);
    expect_once_truth(data, log);
    // x points forward. In this world frame, x points left and y points backward.
    const glm::dvec3 ahead = log.world_from_vehicle.pose[0].rotation * glm::dvec3(1, 0, 0);
    EXPECT_LT(glm::distance(ahead, glm::dvec3(0, -1, 0)), 1e-9);
}

TEST(Once, QuaternionsWithWFirst) {
    const OnceFolder data("w-first", true);
    const Log log = data.load();
    EXPECT_THAT(log.notes, testing::Contains(test::Names("quaternions ... w")));
    expect_once_truth(data, log);
}

TEST(Once, PointsOfAnotherLidar) {
    const OnceFolder data("other");
    // tilts the sensor by up to a degree, so that the points do not form beams
    for (int s = 0; s < OnceFolder::kScans; ++s) {
        std::string bytes = test::read_text(data.scan(s));
        for (std::size_t at = 0; at < bytes.size(); at += 16) {
            float p[3];
            std::memcpy(p, bytes.data() + at, sizeof p);
            p[2] += float(at / 16 % 97) * 1.8e-4f * std::hypot(p[0], p[1]);
            std::memcpy(bytes.data() + at, p, sizeof p);
        }
        test::write_text(data.scan(s), bytes);
    }
    const Log log = data.load();
    EXPECT_EQ(log.frames[0].scan.rays.rows, 1) << "rays without order";
    EXPECT_THAT(log.notes, testing::Contains(test::Names("dropped")));
}

TEST(Once, FramesOtherPosesAndMissingScans) {
    const OnceFolder data("frames");
    const Log some = data.load({.frames = {1, 3}});
    ASSERT_EQ(some.frames.size(), 2u);
    EXPECT_EQ(some.frames[0].index, 1);
    EXPECT_NEAR(some.frames[0].time_s, 0.5, 1e-9);
    data.expect_error("ONCE ... [0, 3]", {.frames = {4, -1}});
    fs::remove(data.scan(1));
    const Log rest = data.load();
    ASSERT_EQ(rest.frames.size(), 3u);
    EXPECT_EQ(rest.frames[1].index, 2);
    EXPECT_THAT(rest.notes, testing::Contains(test::Names("1 frames")));
    data.expect_error("frames.json: 1 frames ... lidar_roof", {.allow_missing_scans = false});
    EXPECT_EQ(data.load({.poses_file = kNoPoses}).world_from_vehicle.pose[2].translation, glm::dvec3(0.0));
}

TEST(Once, SaysWhichFileAndFieldIsWrong) {
    const OnceFolder data("errors");
    const std::string good = test::read_text(data.json());
    const auto with = [&](const std::string& from, const std::string& to, const std::string& part) {
        data.expect_error_with(data.json(), test::replace_first(good, from, to), part);
    };
    const std::string second = R"("frame_id": "16165359667)";
    with(second, R"("frame_id": "x16165359667)", "errors.json: frames[1].frame_id ... 'x1616535966700'");
    with(second, R"("frame_id": "06165359667)", "frames[1].frame_id ... 616535966700 ... 1616535966200");
    with(R"("pose": [)", R"("pose": [0, )", "errors.json: frames[0].pose ... 8 ... 7");
    with(R"("pose": [)", R"("pose": ["x", )", "errors.json: frames[0].pose");
    with(R"("pose": [0)", R"("pose": [2)", "errors.json: frames[0].pose ... 2.236 ... length 1");
    with(R"("pose")", R"("posture")", "errors.json ... frames[0].pose");
    with(R"("frames")", R"("other")", "errors.json ... frames");
    with("]}]", "", "errors.json");
    test::write_text(data.scan(2), "cut");
    data.expect_error("1616535967200.bin ... 3 ... 16");
    fs::remove_all(data.folder / "lidar_roof");
    fs::create_directory(data.folder / "lidar_roof");
    data.expect_error("errors.json ... 4 frames");
    fs::remove(data.json());
    data.expect_error("errors.json");
}

}  // namespace
}  // namespace relidar
