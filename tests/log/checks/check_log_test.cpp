// SPDX-License-Identifier: Apache-2.0
// Invalid logs cause errors, improbable values cause notes, good logs cause neither.
#include <relidar/log/checks.hpp>

#include <gmock/gmock.h>

#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>
#include "log/checks/checks.hpp"
#include "read/scans/pose_conventions.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

const float kNan = std::numeric_limits<float>::quiet_NaN();

const Log& good_log() {
    static const Log log = make_street_log({.n_frames = 3, .rows = 4, .columns = 32});
    return log;
}

std::size_t returned(const Scan& scan) {
    std::size_t i = 0;
    while (!(scan.range_m[i] > 0.0f)) ++i;
    return i;
}

TEST(CheckLog, GoodLogsPass) {
    Log log = good_log();
    EXPECT_NO_THROW(check_log(log));
    Scan& scan = log.frames[1].scan;
    scan.second_returns.assign(1, {std::vector<float>(128, 0.0f), std::vector<float>(128, 0.0f)});
    scan.second_returns[0].range_m[returned(scan)] = 30.0f;
    EXPECT_NO_THROW(check_log(log));
}

void expect_errors(const std::vector<std::pair<std::function<void(Log&)>, std::string>>& cases) {
    for (const auto& [damage, expected] : cases) {
        Log log = good_log();
        damage(log);
        EXPECT_THAT([&] { check_log(log); }, testing::ThrowsMessage<DataError>(test::Names(expected)));
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
    read::fix_inverted_poses(log, {});
    EXPECT_EQ(log.notes, street.notes);
    EXPECT_EQ(largest_error_m(log), 0.0);
    for (Pose& pose : log.world_from_vehicle.pose) {
        pose.translation += log.world_offset_m;
        pose = inverse(pose);
    }
    log.world_offset_m = glm::dvec3(0.0);
    EXPECT_GT(largest_error_m(log), 3.0);
    log.conventions_used.clear();
    read::fix_inverted_poses(log, {});
    EXPECT_LT(largest_error_m(log), 1e-6);
    ASSERT_EQ(log.conventions_used.size(), 1u);
    EXPECT_EQ(log.conventions_used[0].value, "sensor from world");
    EXPECT_THAT(log.conventions_used[0].from, testing::StartsWith("guess: "));
}

TEST(ChoosePoses, WithoutScansANoteAsksWhetherTheVehicleDrivesBackward) {
    PoseTrack backward, forward;
    for (int i = 0; i < 8; ++i) {
        backward.append(0.2 * i, {{0, 0, 0, 1}, {1.5 * i, 0, 0}});  // faces -x
        forward.append(0.2 * i, {{1, 0, 0, 0}, {1.5 * i, 0, 0}});
    }
    Log log;
    EXPECT_EQ(read::choose_poses({{read::kScalarFirst, backward}, {read::kScalarLast, forward}}, nullptr,
                                 "poses", {}, log),
              0u);
    ASSERT_EQ(log.notes.size(), 1u);
    EXPECT_THAT(log.notes[0].text, test::Names("-1.00 m ... 1.00 m ... qx qy qz qw"));
}

TEST(CheckLog, NamesFramePoseOrBox) {
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

TEST(CheckLog, NamesFrameRayAndField) {
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

Log make_log_with_gap(double gap_s) {
    Log log;
    log.name = "log";
    for (int i = 0; i < 10; ++i) log.frames.push_back({i, 0.1 * i + (i > 6 ? gap_s : 0.0), {}});
    return log;
}

TEST(CheckGaps, SaysWhereFramesAreMissing) {
    Log log = make_log_with_gap(4.9);
    checks::note_faults(log);
    ASSERT_EQ(log.notes.size(), 1u);
    EXPECT_EQ(log.notes[0].id, "time_gaps");
    EXPECT_THAT(log.notes[0], test::Names("1 ... 5.0 s ... frames 6 ... 7 ... 0.1 s"));
    log = make_log_with_gap(0.3);
    checks::note_faults(log);
    EXPECT_EQ(log.notes, Notes()) << "frames that a log leaves out";
}

TEST(CheckGaps, AJumpOfTheClockIsAnError) {
    Log log = make_log_with_gap(3600.0);
    EXPECT_THAT([&] { check_log(log); },
                testing::ThrowsMessage<DataError>(test::Names("frame 7 ... 3600.1 s ... frame 6")));
    for (Frame& frame : log.frames) frame.time_s = 100.0 * frame.index;
    EXPECT_NO_THROW(check_log(log)) << "scans that are taken every 100 s";
}

using Change = std::function<void(Log&)>;

const Log& five_frames() {
    static const Log log = make_street_log({.n_frames = 5, .rows = 8, .columns = 128});
    return log;
}

Notes notes_after(const Change& change, Log log = five_frames()) {
    log.notes.clear();
    change(log);
    checks::note_faults(log);
    return log.notes;
}

/// @param values  what the note names, as in test::Names()
void expect_fault(const std::string& id, const std::string& values, const Change& change) {
    const Notes notes = notes_after(change);
    ASSERT_EQ(notes.size(), 1u) << id << "\n" << test::join_lines(notes);
    EXPECT_EQ(notes[0].id, id);
    EXPECT_THAT(notes[0], test::Names(values));
}

Change scale_times(double factor) {
    return [factor](Log& log) {
        for (Frame& frame : log.frames) frame.time_s *= factor;
        for (double& time_s : log.world_from_vehicle.time_s) time_s *= factor;
        for (BoxTrack& box : log.boxes)
            for (double& time_s : box.world_from_box.time_s) time_s *= factor;
    };
}

Change change_intensities(const std::function<float(float)>& change) {
    return [change](Log& log) {
        for (Frame& frame : log.frames)
            for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
                if (frame.scan.range_m[ray] > 0.0f)
                    frame.scan.intensity[ray] = change(frame.scan.intensity[ray]);
    };
}

Change move_to_map(bool is_rounded) {
    return [is_rounded](Log& log) {
        log.world_offset_m = {500000.0, 4000000.0, 100.0};
        for (Pose& pose : log.world_from_vehicle.pose)
            if (is_rounded)
                pose.translation =
                    glm::dvec3(glm::vec3(pose.translation + log.world_offset_m)) - log.world_offset_m;
    };
}

TEST(ImplausibleValues, AreReported) {
    expect_fault("speed", "4 of 4", [](Log& log) {
        for (Pose& pose : log.world_from_vehicle.pose) pose.translation *= 1000.0;
    });
    // Both the step to the outlier and the step back are too fast.
    expect_fault("speed", "2 of 4", [](Log& log) { log.world_from_vehicle.pose[2].translation.y += 30.0; });
    expect_fault("few_returns", "1 of 5 ... frame 3", [](Log& log) {
        Scan& scan = log.frames[3].scan;
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray)
            if (ray % 3 != 0) scan.range_m[ray] = scan.intensity[ray] = 0.0f;
    });
    expect_fault("time_unit", "milliseconds", scale_times(1e3));
    expect_fault("time_unit", "microseconds", scale_times(1e6));
    expect_fault("time_unit", "nanoseconds", scale_times(1e9));
    // The distance between float32 numbers from 2^18 to 2^19 is 2^-5.
    expect_fault("float_positions", "x ... 0.0312 m", move_to_map(true));
    expect_fault("dark", "maximum", change_intensities([](float value) { return value / 255.0f; }));
    expect_fault("saturated", "%",
                 change_intensities([](float value) { return value > 0.2f ? 1.0f : value; }));
    expect_fault("equal_intensities", "0.5", change_intensities([](float) { return 0.5f; }));
    expect_fault("rotation", "counterclockwise ... clockwise", [](Log& log) {
        for (Frame& frame : log.frames)
            for (float& t_s : frame.scan.rays.time_offset_s) t_s = -t_s;
    });
    expect_fault("rotation", "clockwise ... counterclockwise",
                 [](Log& log) { log.lidars[0].sensor.clockwise = false; });
}

TEST(ImplausibleValues, GoodLogsGetNoNote) {
    const auto expect_none = [](const Change& change, const Log& log = five_frames()) {
        EXPECT_EQ(notes_after(change, log), Notes());
    };
    expect_none([](Log&) {});
    expect_none([](Log& log) {
        log.world_from_vehicle.pose[2].translation.y += 30.0;
        log.has_poses = false;
    });
    // Scans that were not read are no incomplete scans.
    expect_none([](Log& log) { log.frames[1].scan = log.frames[3].scan = {}; });
    // A scan every minute, and every fifth scan of a log
    expect_none(scale_times(600.0));
    expect_none(scale_times(5.0));
    expect_none(move_to_map(false));
    // A vehicle that leaves a tunnel: the LiDAR gets fewer returns from scan to scan.
    expect_none(
        [](Log& log) {
            for (std::size_t i = 0; i < log.frames.size(); ++i)
                for (std::size_t ray = 0; ray < log.frames[i].scan.range_m.size(); ++ray)
                    if (ray % 16 < i)
                        log.frames[i].scan.range_m[ray] = log.frames[i].scan.intensity[ray] = 0.0f;
        },
        make_street_log({.n_frames = 12, .rows = 8, .columns = 128}));
}

using testing::HasSubstr;

std::string describe_fault_after(const std::function<void(BoxTrack&, Pose&)>& change) {
    static const Log street = make_street_log({.n_frames = 8, .rows = 32, .columns = 720});
    Log log = street;
    for (BoxTrack& box : log.boxes)
        for (Pose& pose : box.world_from_box.pose) change(box, pose);
    return checks::describe_fault(log);
}

void swap_length_and_width(BoxTrack& box, Pose& pose) {
    if (&pose == &box.world_from_box.pose.front()) std::swap(box.size_m.x, box.size_m.y);
}

TEST(BoxConventions, BottomCentresAndMirroredBoxesAreRecognised) {
    EXPECT_EQ(describe_fault_after([](BoxTrack&, Pose&) {}), "");
    EXPECT_THAT(describe_fault_after([](BoxTrack& box, Pose& pose) {
                    pose.translation -= pose.rotation * glm::dvec3(0, 0, 0.5 * box.size_m.z);
                }),
                HasSubstr("bottom"));
    EXPECT_THAT(describe_fault_after([](BoxTrack&, Pose& pose) {
                    const glm::dquat q = pose.rotation;
                    pose.translation.y = -pose.translation.y;
                    pose.rotation = glm::dquat(q.w, -q.x, q.y, -q.z);
                }),
                HasSubstr("sign"));
}

TEST(BoxConventions, SwappedSidesAndTurnedBoxesAreRecognised) {
    EXPECT_THAT(describe_fault_after(swap_length_and_width), HasSubstr("width"));
    const glm::dquat quarter_turn = make_rotation(kPi / 2, 0, 0);
    EXPECT_THAT(
        describe_fault_after([&](BoxTrack&, Pose& pose) { pose.rotation = pose.rotation * quarter_turn; }),
        HasSubstr("90 degrees"));
    // The length is the y axis of these boxes, which are at the right places.
    EXPECT_EQ(describe_fault_after([&](BoxTrack& box, Pose& pose) {
                  pose.rotation = pose.rotation * quarter_turn;
                  swap_length_and_width(box, pose);
              }),
              "");
}

TEST(BoxConventions, TheBoxOfTheRecordingVehicleIsLeftOut) {
    Log log = make_street_log({.n_frames = 5, .rows = 8, .columns = 128});
    const std::size_t n_boxes = log.boxes.size();
    const auto add_box_around_sensor = [&](const std::string& id, std::size_t n_around) {
        BoxTrack& box = log.boxes.emplace_back(BoxTrack{id, "Car", {4.5, 1.9, 1.6}, log.world_from_vehicle});
        for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k)
            box.world_from_box.pose[k].translation += glm::dvec3(k < n_around ? 0.5 : 20.0, 0.0, -1.2);
    };
    add_box_around_sensor("ego", 5);
    add_box_around_sensor("overtaken", 2);
    log.notes.clear();
    checks::remove_ego_boxes(log);
    ASSERT_EQ(log.boxes.size(), n_boxes + 1);
    EXPECT_EQ(log.boxes.back().id, "overtaken");
    EXPECT_THAT(log.notes, testing::ElementsAre(test::Names("'ego' ... 5 of 5")));
}

}  // namespace
}  // namespace relidar
