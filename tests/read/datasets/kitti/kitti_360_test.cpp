// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstdlib>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_360_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Kitti360Folder;
using test::Names;
using test::read_text;
using test::write_text;
using testing::Contains;

std::size_t points_in(const Log& log, const Frame& frame, const BoxTrack& box) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < frame.scan.rays.size(); ++i)
        n += frame.scan.range_m[i] > 0.0f &&
             box.contains_point(locate_return(log, frame, i).point_m, frame.time_s, 0.0);
    return n;
}

TEST(Kitti360, PointsStandInTheWorldWhereTheyWere) {
    const Kitti360Folder kitti("k360");
    EXPECT_EQ(detect_kind(kitti.folder), "kitti360");
    const Log log = kitti.load();
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_TRUE(log.rolling_shutter);
    EXPECT_EQ(log.frames[0].index, Kitti360Folder::kFirst);
    EXPECT_NEAR(log.frames[2].time_s - log.frames[0].time_s, 0.2, 1e-9);
    EXPECT_NEAR(log.frames[0].time_s, 235.0, 1e-9) << "after the drive's first sweep";
    EXPECT_NEAR(log.lidars[0].sensor.period_s, 0.1, 1e-9);
    EXPECT_EQ(log.lidars[0].sensor.columns, test::KittiDrive::kFirings);
    EXPECT_EQ(log.frames[0].scan.count_returns(), kitti.sweeps.n_points);
    double farthest = 0.0, latest = 0.0;
    for (const Frame& frame : log.frames)
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const glm::dvec3 point(frame.scan.return_point(i));
            const double late = double(frame.scan.rays.time_offset_s[i]) / Kitti360Folder::kPeriod_s;
            const glm::dvec3 truth(Kitti360Folder::compute_world_from_velo(frame.index + late) *
                                   glm::dvec4(point, 1.0));
            farthest = std::max(
                farthest, glm::distance(truth, locate_return(log, frame, i).point_m + log.world_offset_m));
            const double head = std::atan2(point.y, point.x) -
                                log.lidars[0].sensor.beams[frame.scan.rays.channel[i]].azimuth_offset_rad;
            latest = std::max(latest, std::abs(std::remainder(late + head / (2 * kPi), 1.0)));
        }
    EXPECT_LT(farthest, 1e-3);
    EXPECT_LT(latest, 2e-3) << "of a turn: the left offset turns a ray by 26 mm over its range";
}

TEST(Kitti360, BoxesHoldWhatWasLabelled) {
    const Kitti360Folder kitti("k360_boxes");
    const Log log = kitti.load();
    ASSERT_EQ(log.boxes.size(), 2u);
    const BoxTrack &driving = log.boxes[0], &standing = log.boxes[1];
    EXPECT_EQ(driving.id, "13005");
    EXPECT_EQ(standing.id, "13007");
    EXPECT_EQ(driving.category, "car");
    EXPECT_LT(glm::distance(driving.size_m, glm::dvec3(6, 3, 2)), 1e-9);
    EXPECT_LT(glm::distance(standing.size_m, glm::dvec3(8, 4, 2)), 1e-9);
    ASSERT_EQ(driving.world_from_box.pose.size(), 3u);
    ASSERT_EQ(standing.world_from_box.pose.size(), 2u) << "of the frames in its window";
    for (int i = 0; i < 3; ++i) {
        const glm::dmat4 truth = Kitti360Folder::compute_world_from_velo(Kitti360Folder::kFirst + i) *
                                 test::make_box_matrix({9.5, 0, 0}, 0.3, {1, 1, 1});
        const Pose& actual = driving.world_from_box.pose[std::size_t(i)];
        EXPECT_EQ(driving.world_from_box.time_s[std::size_t(i)], log.frames[std::size_t(i)].time_s);
        EXPECT_LT(glm::distance(actual.translation + log.world_offset_m, glm::dvec3(truth[3])), 1e-6);
        EXPECT_LT(glm::distance(actual.rotation * glm::dvec3(1, 0, 0), glm::dvec3(truth[0])), 1e-9);
        EXPECT_LT(glm::distance(actual.rotation * glm::dvec3(0, 0, 1), glm::dvec3(truth[2])), 1e-9);
    }
    EXPECT_EQ(standing.world_from_box.pose[0].translation, standing.world_from_box.pose[1].translation);
    for (const Frame& frame : log.frames) EXPECT_GT(points_in(log, frame, driving), 100u) << frame.index;
    EXPECT_FALSE(standing.is_observed(log.frames[0].time_s)) << "not labelled there";
    EXPECT_GT(points_in(log, log.frames[1], standing), 100u);
    EXPECT_GT(points_in(log, log.frames[2], standing), 100u);
}

TEST(Kitti360, DrivesAndPartsHaveNames) {
    const Kitti360Folder kitti("k360_names");
    const Log log = kitti.load({.sequence = "kd1"});
    ASSERT_EQ(log.frames.size(), 2u);
    EXPECT_EQ(log.frames[0].index, 2351);
    EXPECT_EQ(log.start_unix_ns, 1369730760904000000) << "2013-05-28 08:46:00.904";
    EXPECT_EQ(log.test_frames, (std::vector<int>{2360, 2370, 2380, 2390}));
    EXPECT_EQ(kitti.load({.sequence = "kd1", .frames = {2352, -1}}).frames.size(), 1u);
    EXPECT_THROW(kitti.load({.sequence = "kd1", .frames = {0, 2351}}), UsageError);
    for (const char* name : {"0000", "2013_05_28_drive_0000_sync"}) {
        const Log named = kitti.load({.sequence = name});
        EXPECT_EQ(named.frames.size(), 3u);
        EXPECT_TRUE(named.test_frames.empty()) << "nobody has published a split of the drive";
    }
    kitti.expect_error("dataset.sequence ... '0003' ... (2013_05_28_drive_0000_sync) ... ks1",
                       {.sequence = "0003"});
    const fs::path drive = kitti.folder / "data_3d_raw" / Kitti360Folder::kDrive;
    EXPECT_THAT(test::find_load_error(drive.string()), Names("drive ... KITTI-360"));
    EXPECT_THROW(load_log(kitti.sweeps.folder.string(), {.sequence = "0001"}), UsageError);
}

TEST(Kitti360, FramesWithoutAPose) {
    const Kitti360Folder kitti("k360_gaps");
    kitti.write_poses({2350, 2352});
    Log log = kitti.load();
    ASSERT_EQ(log.frames.size(), 3u);
    EXPECT_THAT(log.notes, Contains(Names("interpolated ... data_poses ... 2351")));
    const glm::dvec3 there(Kitti360Folder::compute_world_from_velo(2351)[3]);
    EXPECT_LT(glm::distance(log.world_from_vehicle.pose[1].translation + log.world_offset_m, there), 1e-3);
    kitti.write_poses({2345, 2351});  // six frames apart; half a second is five frames
    log = kitti.load();
    ASSERT_EQ(log.frames.size(), 1u);
    EXPECT_THAT(log.notes, Contains(Names("pose ... 2350, 2352")));
    // Makes a long gap between poses during which the car does not move.
    const std::string line = read_text(kitti.poses());
    const std::string pose = line.substr(line.find(' '), line.find('\n') - line.find(' '));
    write_text(kitti.poses(), "2300" + pose + "\n2400" + pose + "\n");
    EXPECT_EQ(kitti.load().frames.size(), 3u);
    kitti.write_poses({100, 200});
    kitti.expect_error("frames 2350 ... 2352 ... pose ... 100 ... 200");
}

TEST(Kitti360, BoxesGoAlongWithOtherPoses) {
    const Kitti360Folder kitti("k360_poses");
    DatasetOptions options{.poses_file = kNoPoses};
    const Log none = kitti.load(options);
    EXPECT_EQ(none.world_from_vehicle.pose[2].translation, glm::dvec3(0.0));
    ASSERT_EQ(none.boxes.size(), 2u);
    for (const Pose& pose : none.boxes[0].world_from_box.pose)
        EXPECT_LT(glm::distance(pose.translation, glm::dvec3(9.5, 0, 0)), 1e-6);
    std::string lines;
    for (int frame = 0; frame < 2353; ++frame) lines += fmt::format("1 0 0 {} 0 1 0 0 0 0 1 0\n", frame);
    options.poses_file = kitti.folder / "mine.txt";
    write_text(options.poses_file, lines);
    const Log mine = kitti.load(options);
    EXPECT_EQ(mine.world_offset_m, glm::dvec3(2351, 0, 0));
    EXPECT_LT(glm::distance(mine.boxes[0].world_from_box.pose[2].translation, glm::dvec3(10.5, 0, 0)), 1e-6);
    fs::remove_all(kitti.folder / "data_poses");
    EXPECT_THAT(kitti.load(options).notes, Contains(Names("data_poses ... boxes")));
    EXPECT_TRUE(kitti.load(options).boxes.empty());
}

// Objects of drive 0004 have no numbers. It has objects only in train_full, other drives
// may have only the folder train, as here.
TEST(Kitti360, ObjectsWithoutNumbersGoByTheirLabels) {
    const Kitti360Folder kitti("k360_0004");
    const glm::dmat4 world_from_object =
        Kitti360Folder::compute_world_from_velo(2351) * test::make_box_matrix({9.5, 0, 0}, 0.0, {1, 2, 3});
    const auto fields = [](const std::string& label, int index, int timestamp) {
        return fmt::format(
            "<index>{}</index><label>{}</label><timestamp>{}</timestamp><dynamic>{}</dynamic><dynamicSeq>4</"
            "dynamicSeq><start_frame>2351</start_frame><end_frame>2351</end_frame>",
            index, label, timestamp, timestamp < 0 ? 0 : 1);
    };
    fs::remove(kitti.boxes());
    write_text(
        kitti.folder / "data_3d_bboxes/train" / kitti.boxes().filename(),
        test::make_boxes_xml(test::make_object_xml(1, fields("pedestrian", 11, 2350), world_from_object) +
                             test::make_object_xml(2, fields("pedestrian", 12, 2351), world_from_object) +
                             test::make_object_xml(3, fields("car", 13, -1), world_from_object) +
                             test::make_object_xml(4, fields("trafficSign", 14, -1), world_from_object)));
    const Log log = kitti.load();
    ASSERT_EQ(log.boxes.size(), 2u);
    EXPECT_EQ(log.boxes[0].id, "car-13");
    EXPECT_EQ(log.boxes[0].world_from_box.pose.size(), 1u);
    EXPECT_EQ(log.boxes[1].id, "person-moving-4");
    EXPECT_EQ(log.boxes[1].category, "person");
    EXPECT_EQ(log.boxes[1].world_from_box.pose.size(), 2u);
    fs::remove_all(kitti.folder / "data_3d_bboxes");
    EXPECT_THAT(kitti.load().notes, Contains(Names("data_3d_bboxes ... labels")));
}

TEST(Kitti360, SaysWhichFileIsWrong) {
    const Kitti360Folder kitti("k360_errors");
    const std::string poses = read_text(kitti.poses()), line = poses.substr(0, poses.find('\n') + 1);
    const auto expect = [&](const fs::path& file, const std::string& text, const std::string& parts) {
        kitti.expect_error_with(file, text, parts);
    };
    expect(kitti.poses(), "", "poses.txt ... empty");
    expect(kitti.poses(), line.substr(0, line.size() / 2), "poses.txt line 1: ");
    expect(kitti.poses(), line + line, "poses.txt line 2 ... frame '2350'");
    expect(kitti.poses(), "x" + line, "poses.txt line 1 ... frame 'x2350'");
    expect(kitti.calibration("calib_cam_to_pose.txt"), "image_01: 1\n",
           "calib_cam_to_pose.txt ... line 'image_00:'");
    expect(kitti.calibration("calib_cam_to_velo.txt"), "1 0 0 0\n",
           "calib_cam_to_velo.txt line 1 ... 4 ... 12");
    expect(kitti.raw() / "timestamps.txt", "2013-05-28 08:46:02.9\n", "timestamps.txt ... sweep");
    expect(kitti.raw() / "timestamps.txt", "2013-05-28 08:46:02.9\n2013-05-28 08:47:02.9\n",
           "sweep ... 60 s");
    fs::remove(kitti.calibration("calib_cam_to_velo.txt"));
    EXPECT_THROW(kitti.load(), DataError);
    fs::remove_all(kitti.raw());
    EXPECT_THROW(kitti.load(), DataError);
}

TEST(Kitti360, SaysWhichBoxIsWrong) {
    const Kitti360Folder kitti("k360_box_errors");
    const std::string original = read_text(kitti.boxes());
    const auto expect = [&](const std::string& from, const std::string& to, const std::string& part) {
        kitti.expect_error_with(kitti.boxes(), test::replace_first(original, from, to), part);
    };
    expect("</opencv_storage>", "", ".xml ... malformed");
    expect("<semanticId>13</semanticId>", "<semanticId>x</semanticId>", "object0: semanticId ... 'x'");
    expect("<instanceId>5</instanceId>", "<instanceId>5e9</instanceId>", "object0: instanceId ... '5e9'");
    expect("<timestamp>-1</timestamp>", "<timestamp>1.5</timestamp>", "object3: timestamp ... '1.5'");
    expect("<start_frame>2351</start_frame>", "", "object3: start_frame ... ''");
    expect("<rows>4</rows>", "<rows>400000000</rows>", "object0 ... rows ... '400000000'");
    expect("<cols>4</cols>", "<cols>3</cols>", "object0 ... 4 ... 3 ... 16");
    expect("e+00 ", "e+00 nan ", "object0 ... 4 ... 4 ... 17");
    expect("e+00 ", "e+99 ", "object0: number 1 ... transform ... ");
    expect("<semanticId>13</semanticId>\n  <instanceId>7", "<semanticId>14</semanticId>\n  <instanceId>-995",
           "object3 ... truck ... 13005");
    write_text(kitti.boxes(), "<html/>");
    kitti.expect_error_with(kitti.boxes(), "<html/>", "opencv_storage");
    const glm::dmat4 sheared{{2, 0, 0, 0}, {1, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    const auto one = [](const glm::dmat4& matrix) {
        return test::make_boxes_xml(
            test::make_object_xml(0, test::make_object_fields("bus", 34, 1, 2351, 0, 0), matrix));
    };
    kitti.expect_error_with(kitti.boxes(), one(sheared), "object0 ... rotation");
    kitti.expect_error_with(kitti.boxes(), one(glm::dmat4(0.0)), "object0 ... rotation");
}

}  // namespace
}  // namespace relidar
