// SPDX-License-Identifier: Apache-2.0
#include "log/checks/checks.hpp"

#include <relidar/read/dataset.hpp>

#include "support/names.hpp"

namespace relidar {
namespace {

using Change = std::function<void(Log&)>;

const Log& make_log() {
    static const Log log = make_street_log({.n_frames = 5, .rows = 8, .columns = 128});
    return log;
}

void expect_no_fault(const Change& change, Log log = make_log()) {
    log.notes.clear();
    change(log);
    checks::note_faults(log);
    EXPECT_EQ(log.notes, Notes());
}

/// @param values  what the note names, as in test::Names()
void expect_fault(const std::string& id, const std::string& values, const Change& change) {
    Log log = make_log();
    log.notes.clear();
    change(log);
    checks::note_faults(log);
    ASSERT_EQ(log.notes.size(), 1u) << id << "\n" << test::join_lines(log.notes);
    EXPECT_EQ(log.notes[0].id, id);
    EXPECT_THAT(log.notes[0], test::Names(values));
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
    expect_no_fault([](Log&) {});
    expect_no_fault([](Log& log) {
        log.world_from_vehicle.pose[2].translation.y += 30.0;
        log.has_poses = false;
    });
    // Scans that were not read are no incomplete scans.
    expect_no_fault([](Log& log) { log.frames[1].scan = log.frames[3].scan = {}; });
    // A scan every minute, and every fifth scan of a log
    expect_no_fault(scale_times(600.0));
    expect_no_fault(scale_times(5.0));
    expect_no_fault(move_to_map(false));
    // A vehicle that leaves a tunnel: the LiDAR gets fewer returns from scan to scan.
    expect_no_fault(
        [](Log& log) {
            for (std::size_t i = 0; i < log.frames.size(); ++i)
                for (std::size_t ray = 0; ray < log.frames[i].scan.range_m.size(); ++ray)
                    if (ray % 16 < i)
                        log.frames[i].scan.range_m[ray] = log.frames[i].scan.intensity[ray] = 0.0f;
        },
        make_street_log({.n_frames = 12, .rows = 8, .columns = 128}));
}

}  // namespace
}  // namespace relidar
