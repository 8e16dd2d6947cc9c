// SPDX-License-Identifier: Apache-2.0
// Checks the notes about values that are valid but probably wrong. A good log gets none.
#include "log/clouds/implausible_values.hpp"

#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <relidar/log/dataset.hpp>

namespace relidar {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

Notes get_notes_after(const std::function<void(LidarSequence&)>& change) {
    static const LidarSequence log = make_synthetic_street({.n_frames = 5, .rows = 8, .columns = 128});
    LidarSequence changed = log;
    changed.notes.clear();
    change(changed);
    folder::add_notes_about_implausible_values(changed);
    return changed.notes;
}

void change_intensities(LidarSequence& log, const std::function<float(float)>& change) {
    for (LidarFrame& frame : log.frames)
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f) frame.scan.intensity[ray] = change(frame.scan.intensity[ray]);
}

TEST(ImplausibleValues, AGoodLogGetsNoNote) {
    EXPECT_THAT(get_notes_after([](LidarSequence&) {}), IsEmpty());
}

TEST(ImplausibleValues, PosesInMillimetresAndOutliersAreReported) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    for (Pose& pose : log.world_from_vehicle.pose) pose.translation *= 1000.0;
                }),
                ElementsAre(HasSubstr("in 4 of 4 steps")));
    // Both the step to the outlier and the step back are too fast.
    EXPECT_THAT(
        get_notes_after([](LidarSequence& log) { log.world_from_vehicle.pose[2].translation.y += 30.0; }),
        ElementsAre(HasSubstr("in 2 of 4 steps")));
    // Without poses there is nothing to report.
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    log.world_from_vehicle.pose[2].translation.y += 30.0;
                    log.has_poses = false;
                }),
                IsEmpty());
}

TEST(ImplausibleValues, ScansWithFewReturnsAreReported) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    Scan& scan = log.frames[3].scan;
                    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray)
                        if (ray % 3 != 0) scan.range_m[ray] = scan.intensity[ray] = 0.0f;
                }),
                ElementsAre(AllOf(HasSubstr("1 of 5 scans"), HasSubstr("frame 3 has only"))));
}

TEST(ImplausibleValues, ScansThatWereNotReadAreNoIncompleteScans) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) { log.frames[1].scan = log.frames[3].scan = {}; }),
                IsEmpty());
}

TEST(ImplausibleValues, ASlowChangeOfTheNumberOfReturnsIsNoFault) {
    // A vehicle that leaves a tunnel: the LiDAR gets fewer returns from scan to scan.
    LidarSequence log = make_synthetic_street({.n_frames = 12, .rows = 8, .columns = 128});
    for (std::size_t i = 0; i < log.frames.size(); ++i)
        for (std::size_t ray = 0; ray < log.frames[i].scan.range_m.size(); ++ray)
            if (ray % 16 < i) log.frames[i].scan.range_m[ray] = log.frames[i].scan.intensity[ray] = 0.0f;
    log.notes.clear();
    folder::add_notes_about_implausible_values(log);
    EXPECT_THAT(log.notes, IsEmpty());
}

TEST(ImplausibleValues, WrongUnitsOfBoxesAreReported) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) { log.boxes[0].size_m *= 1000.0; }),
                ElementsAre(HasSubstr("m long; expected metres")));
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    for (double& time_s : log.boxes[0].world_from_box.time_s) time_s += 1.7e9;
                }),
                ElementsAre(HasSubstr("the times of 1 of ")));
}

TEST(ImplausibleValues, FrameTimesInAnotherUnitAreReported) {
    const auto scale_times = [](double factor) {
        return [factor](LidarSequence& log) {
            for (LidarFrame& frame : log.frames) frame.time_s *= factor;
            for (double& time_s : log.world_from_vehicle.time_s) time_s *= factor;
            for (BoxTrack& box : log.boxes)
                for (double& time_s : box.world_from_box.time_s) time_s *= factor;
        };
    };
    EXPECT_THAT(get_notes_after(scale_times(1e3)),
                ElementsAre(HasSubstr("in milliseconds, expected seconds")));
    EXPECT_THAT(get_notes_after(scale_times(1e6)),
                ElementsAre(HasSubstr("in microseconds, expected seconds")));
    EXPECT_THAT(get_notes_after(scale_times(1e9)),
                ElementsAre(HasSubstr("in nanoseconds, expected seconds")));
    // A scan every minute, and every fifth scan of a log, are no faults.
    EXPECT_THAT(get_notes_after(scale_times(600.0)), IsEmpty());
    EXPECT_THAT(get_notes_after(scale_times(5.0)), IsEmpty());
    // The rays of a scan cannot take longer than the time to the next scan.
    EXPECT_THAT(get_notes_after(scale_times(0.1)), Contains(HasSubstr("the rays of a scan take")));
}

TEST(ImplausibleValues, PositionsInSinglePrecisionAreReported) {
    const auto move_to_map = [](bool is_rounded) {
        return [is_rounded](LidarSequence& log) {
            log.world_offset_m = {500000.0, 4000000.0, 100.0};
            if (is_rounded)
                for (Pose& pose : log.world_from_vehicle.pose)
                    pose.translation =
                        glm::dvec3(glm::vec3(pose.translation + log.world_offset_m)) - log.world_offset_m;
        };
    };
    // The distance between float32 numbers from 2^18 to 2^19 is 2^-5.
    EXPECT_THAT(get_notes_after(move_to_map(true)),
                ElementsAre(HasSubstr("all x coordinates are multiples of 0.0312 m")));
    EXPECT_THAT(get_notes_after(move_to_map(false)), IsEmpty());
}

TEST(ImplausibleValues, WrongScalesOfIntensitiesAreReported) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    change_intensities(log, [](float value) { return value / 255.0f; });
                }),
                ElementsAre(HasSubstr("the largest intensity is")));
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    change_intensities(log, [](float value) { return value > 0.2f ? 1.0f : value; });
                }),
                ElementsAre(HasSubstr("% of the returns have the maximum intensity")));
    EXPECT_THAT(
        get_notes_after([](LidarSequence& log) { change_intensities(log, [](float) { return 0.5f; }); }),
        ElementsAre(HasSubstr("all intensities of the log are 0.5 of the maximum")));
}

TEST(ImplausibleValues, TimesAgainstTheRotationAreReported) {
    EXPECT_THAT(get_notes_after([](LidarSequence& log) {
                    for (LidarFrame& frame : log.frames)
                        for (float& t_s : frame.scan.rays.time_offset_s) t_s = -t_s;
                }),
                ElementsAre(HasSubstr("turns counterclockwise, but its sensor turns clockwise")));
    EXPECT_THAT(get_notes_after([](LidarSequence& log) { log.lidars[0].sensor.clockwise = false; }),
                ElementsAre(HasSubstr("turns clockwise, but its sensor turns counterclockwise")));
}

}  // namespace
}  // namespace relidar
