// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/checks.hpp>
#include <relidar/read/clouds.hpp>

#include <relidar/read/dataset.hpp>

#include "log/checks/checks.hpp"
#include "read/scans/pose_conventions.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

const float kNan = std::numeric_limits<float>::quiet_NaN();

const Log& make_good_sequence() {
    static const Log log = make_street_log({.n_frames = 3, .rows = 4, .columns = 32});
    return log;
}

std::size_t returned(const Scan& scan) {
    std::size_t i = 0;
    while (!(scan.range_m[i] > 0.0f)) ++i;
    return i;
}

TEST(CheckSequence, GoodLogsPass) {
    Log log = make_good_sequence();
    EXPECT_NO_THROW(check_sequence(log));
    Scan& scan = log.frames[1].scan;
    scan.second_returns.assign(1, {std::vector<float>(128, 0.0f), std::vector<float>(128, 0.0f)});
    scan.second_returns[0].range_m[returned(scan)] = 30.0f;
    EXPECT_NO_THROW(check_sequence(log));
}

void expect_errors(const std::vector<std::pair<std::function<void(Log&)>, std::string>>& cases) {
    for (const auto& [damage, expected] : cases) {
        Log log = make_good_sequence();
        damage(log);
        EXPECT_THAT([&] { check_sequence(log); }, testing::ThrowsMessage<DataError>(test::Names(expected)));
    }
}

TEST(CorrectInversePoses, IfTheScansConfirm) {
    const Log street = make_street_log({.n_frames = 12, .rows = 16, .columns = 240, .moving_cars = false});
    const auto largest_error_m = [&](const Log& log) {
        double largest_m = 0.0;
        const Pose first = inverse(log.world_from_vehicle.pose[0]),
                   truth = inverse(street.world_from_vehicle.pose[0]);
        for (std::size_t i = 0; i < 12; ++i)
            largest_m =
                std::max(largest_m, glm::distance((first * log.world_from_vehicle.pose[i]).translation,
                                                  (truth * street.world_from_vehicle.pose[i]).translation));
        return largest_m;
    };
    Log log = street;
    read::fix_inverted_poses(log);
    EXPECT_EQ(log.notes, street.notes);
    EXPECT_EQ(largest_error_m(log), 0.0);
    for (Pose& pose : log.world_from_vehicle.pose) {
        pose.translation += log.world_offset_m;
        pose = inverse(pose);
    }
    log.world_offset_m = glm::dvec3(0.0);
    EXPECT_GT(largest_error_m(log), 3.0);
    read::fix_inverted_poses(log);
    EXPECT_LT(largest_error_m(log), 1e-6);
    ASSERT_EQ(log.notes.size(), street.notes.size() + 1);
    EXPECT_THAT(log.notes.back(), testing::HasSubstr("sensor-from-world"));
}

TEST(ChoosePoses, WithoutScansANoteAsksWhetherTheVehicleDrivesBackward) {
    PoseTrack backward, forward;
    for (int i = 0; i < 8; ++i) {
        backward.time_s.push_back(0.2 * i);
        backward.pose.push_back({{0, 0, 0, 1}, {1.5 * i, 0, 0}});  // faces -x
        forward.pose.push_back({{1, 0, 0, 0}, {1.5 * i, 0, 0}});
    }
    forward.time_s = backward.time_s;
    Notes notes;
    EXPECT_EQ(read::choose_poses({{read::kScalarFirst, backward}, {read::kScalarLast, forward}}, nullptr,
                                 "poses", notes),
              0u);
    ASSERT_EQ(notes.size(), 1u);
    EXPECT_THAT(notes[0], test::Names("uncertain ... -1.00 m ... 1.00 m with qx qy qz qw ... first line"));
}

TEST(CheckSequence, NamesFramePoseOrBox) {
    expect_errors({
        {[](Log& s) { s.frames.clear(); }, "frame"},
        {[](Log& s) { s.lidars.push_back(s.lidars[0]); }, "LiDARs ... ''"},
        {[](Log& s) { s.lidars[0].vehicle_from_sensor.rotation.w = 2.0; },
         "LiDAR '' ... vehicle_from_sensor ... 2"},
        {[](Log& s) { s.frames[2].time_s = s.frames[1].time_s; }, "frame 2 ... 0.1 s ... frame 1 ... 0.1 s"},
        {[](Log& s) { s.frames[2].time_s = s.frames[1].time_s + 1e-5; }, "frame 2 ... time"},
        {[](Log& s) { s.frames[2].index = 1; }, "frame 1"},
        {[](Log& s) { s.world_from_vehicle.pose[1].translation.x = double(kNan); },
         "vehicle, pose 1 ... (nan"},
        {[](Log& s) { s.world_from_vehicle.pose[1].translation.x = 5e6; }, "5000000 ... 1000000 m"},
        {[](Log& s) { s.boxes[1].size_m.y = 0.0; }, "box '1' ... 0"},
        {[](Log& s) { std::swap(s.boxes[1].world_from_box.time_s[0], s.boxes[1].world_from_box.time_s[1]); },
         "box '1', pose 1 ... 0 s ... 0.1 s"},
        {[](Log& s) { s.boxes[1].world_from_box.pose[2].translation.y += 4e5; },
         "box '1', pose 2: ... 100000 m"},
    });
}

TEST(CheckSequence, NamesFrameRayAndField) {
    expect_errors({
        {[](Log& s) { s.frames[1].scan.range_m.pop_back(); }, "frame 1, range_m ... 127 ... 4 x 32"},
        {[](Log& s) { s.frames[1].scan.rays.channel.clear(); }, "frame 1, rays.channel ... 0"},
        {[](Log& s) { s.frames[1].scan.rays.rows = 1 << 30; }, "frame 1 ... 1073741824 x 32"},
        {[](Log& s) { s.frames[1].scan.rays.direction[5] *= 1.1f; },
         "frame 1, ray 5 ... rays.direction ... 1.1"},
        {[](Log& s) { s.frames[1].scan.rays.origin[5].z = kNan; }, "frame 1, ray 5 ... rays.origin ... nan"},
        {[](Log& s) { s.frames[1].scan.rays.time_offset_s[5] = 1e9f; },
         "frame 1, ray 5, rays.time_offset_s ... 1000000000"},
        {[](Log& s) { s.frames[1].scan.rays.channel[5] = 4; }, "frame 1, ray 5, rays.channel ... 4 ... 3"},
        {[](Log& s) { s.frames[1].scan.rays.divergence_rad = -1e-3f; },
         "frame 1, ray 0, divergence ... -0.001"},
        {[](Log& s) { s.frames[2].scan.range_m[7] = kNan; }, "frame 2, ray 7, range_m ... nan"},
        {[](Log& s) { s.frames[2].scan.range_m[7] = -1.0f; }, "frame 2, ray 7, range_m ... -1"},
        {[](Log& s) { s.frames[2].scan.intensity[returned(s.frames[2].scan)] = 255.0f; },
         "intensity ... 255"},
        {[](Log& s) { s.frames[2].scan.range_m[returned(s.frames[2].scan)] = 0.0f; }, "intensity ... 0"},
        {[](Log& s) { s.frames[2].scan.second_returns.resize(1); }, "frame 2, second_returns.range_m ... 0"},
        {[](Log& s) {
             Scan& scan = s.frames[2].scan;
             scan.range_m[3] = scan.intensity[3] = 0.0f;
             scan.second_returns.assign(1, {std::vector<float>(128, 0.0f), std::vector<float>(128, 0.0f)});
             scan.second_returns[0].range_m[3] = 9.0f;
         },
         "frame 2, ray 3, second_returns.range_m ... 9"},
    });
}

Log make_sequence_with_gap(double gap_s) {
    Log log;
    log.name = "log";
    for (int i = 0; i < 10; ++i) log.frames.push_back({i, 0.1 * i + (i > 6 ? gap_s : 0.0), {}});
    return log;
}

TEST(CheckGaps, SaysWhereFramesAreMissing) {
    Log log = make_sequence_with_gap(4.9);
    checks::note_faults(log);
    ASSERT_EQ(log.notes.size(), 1u);
    EXPECT_EQ(log.notes[0].id, "time_gaps");
    EXPECT_THAT(log.notes[0], test::Names("1 ... 5.0 s ... frames 6 and 7 ... 0.1 s"));
    log = make_sequence_with_gap(0.3);
    checks::note_faults(log);
    EXPECT_EQ(log.notes, Notes()) << "frames that a log leaves out";
}

TEST(CheckGaps, AJumpOfTheClockIsAnError) {
    Log log = make_sequence_with_gap(3600.0);
    EXPECT_THAT([&] { check_sequence(log); },
                testing::ThrowsMessage<DataError>(test::Names("frame 7 ... 3600.1 s ... frame 6")));
    for (Frame& frame : log.frames) frame.time_s = 100.0 * frame.index;
    EXPECT_NO_THROW(check_sequence(log)) << "scans that are taken every 100 s";
}

}  // namespace
}  // namespace relidar
