// SPDX-License-Identifier: Apache-2.0
// Notes for users about how points became scans.

#include <fmt/format.h>

#include "read/scans/point_times.hpp"
#include "read/scans/pose_conventions.hpp"
#include "read/scans/scan_plan.hpp"

namespace relidar::read {
namespace {

// If a larger share of the points fits no ray, the sensor of the log is probably wrong.
constexpr double kMaxSkippedShare = 0.1;
// If scans are farther apart, the check "time_unit" reports a wrong unit of their times.
constexpr double kMaxFrameStep_s = 20.0;

void add_lidar_note(Log& log, int lidar_index, const std::string& text) {
    const std::string& name = log.lidars[std::size_t(lidar_index)].name;
    log.notes.push_back({"", lidar_index, name.empty() ? text : "LiDAR '" + name + "': " + text});
}

/// Adds a note if points of a LiDAR are skipped because their ray has a nearer point. If
/// they are many, the note names the usual cause.
/// @param counts  [frames] `first` includes the skipped points
void note_occupied_rays(Log& log, const ScanLayout& layout, int lidar_index,
                        const std::vector<PointCounts>& counts) {
    std::size_t n_skipped = 0, n_all = 0;
    for (std::size_t i = 0; i < counts.size(); ++i) {
        if (log.frames[i].lidar != lidar_index) continue;
        n_skipped += counts[i].behind;
        n_all += counts[i].first;
    }
    if (n_skipped == 0) return;
    std::string cause;
    if (double(n_skipped) > kMaxSkippedShare * double(n_all)) {
        const bool has_described_beams =
            layout.lidars[std::size_t(lidar_index)].has_beams && layout.is_described;
        cause = has_described_beams ? "; the usual cause is a sensor in sequence.json that did not measure "
                                      "these points"
                                    : "; the usual cause is several returns of each ray without numbers";
    }
    add_lidar_note(log, lidar_index,
                   fmt::format("{} of {} points ({:.2g} %) are skipped, because their ray has a nearer "
                               "point and no neighbouring ray is free{}",
                               n_skipped, n_all, 100.0 * double(n_skipped) / double(n_all), cause));
}

/// Returns how points are assigned to rays. Returns an empty text in the usual cases: the
/// rings are numbers of known beams, or the LiDAR does not spin.
/// @param is_described  the user describes the LiDAR in sequence.json
std::string describe_assignment(const ScanPlan& plan, bool is_described) {
    if (!plan.why_no_beams.empty())
        return fmt::format("{}; therefore each point becomes one ray, and dropped rays are unknown{}",
                           plan.why_no_beams,
                           is_described && !plan.has_rings
                               ? "; set the key \"sensor\" of the LiDAR in sequence.json to define its beams"
                               : "");
    if (plan.is_fitted)
        return fmt::format("a sensor with {} beams and {} columns was fitted to the points{}{}",
                           plan.sensor.beams.size(), plan.sensor.columns,
                           plan.has_rings ? "" : ", which have no rings",
                           plan.ring_order ? "; their order in the file shows the rings" : "");
    if (plan.has_beams && !plan.has_rings)
        return "the points have no rings; each point is assigned to the beam with the nearest elevation";
    return "";
}

}  // namespace

void note_plan(Log& log, const ScanLayout& layout, int lidar_index, const ScanPlan& plan,
               const std::vector<LidarPoints>& samples) {
    const auto add = [&](const std::string& text) {
        if (!text.empty()) add_lidar_note(log, lidar_index, text);
    };
    if (samples.empty()) add("no scan has a point with finite coordinates and a plausible time");
    add(describe_assignment(plan, layout.is_described));
    if (layout.motion_compensated && !plan.undoes_motion)
        add(
            fmt::format("the scans stay motion-compensated, because the firing times{} or the poses are not "
                        "known; all rays start at the sensor's position at the time of the frame",
                        layout.lidars.size() > 1 ? " of all LiDARs" : ""));
    if (!layout.motion_compensated && plan.has_beams && !plan.has_times)
        add(
            fmt::format("the points have no times; relidar computes them from the azimuths and assumes that "
                        "a sweep takes {:.3g} s and that the head faces forward at the time of the frame",
                        plan.sensor.period_s));
    const std::optional<double> step_s = median_step_s(log, lidar_index);
    if (!layout.motion_compensated && step_s && *step_s <= kMaxFrameStep_s)
        add(describe_span(samples, *step_s));
    if (plan.firings) add(describe_recovery(plan.firings->recovery));
    if (plan.unmarked_firings)
        add(fmt::format(
            "the scans seem to be motion-compensated: without the compensation, the elevations of "
            "a beam differ by {:.4f} instead of {:.4f} degrees; if they are, set "
            "\"motion_compensated\": true in sequence.json",
            plan.unmarked_firings->recovery.spread_rad * 180.0 / kPi,
            plan.unmarked_firings->recovery.compensated_spread_rad * 180.0 / kPi));
    const std::string& name = log.lidars[std::size_t(lidar_index)].name;
    const std::string of_lidar = name.empty() ? "" : " of " + name;
    if (plan.has_beams && plan.has_rings && !plan.is_fitted)
        list_convention(
            log, {"ring 0" + of_lidar,
                  layout.lidars[std::size_t(lidar_index)].lowest_first ? "lowest beam" : "highest beam",
                  layout.are_rings_set ? kFromSetting : layout.declared_by, "conventions.rings"});
    if (plan.moved_to_s)
        list_convention(log, {"points" + of_lidar, "motion-compensated",
                              "guess: the beams then have constant elevations", "conventions.deskew"});
    if (plan.moved_to_s)
        add(
            fmt::format("the points were moved to the time {:.4f} s after the frame, because their beams "
                        "then have constant elevations; relidar moved each point back to its firing time",
                        *plan.moved_to_s));
}

void note_skipped_points(Log& log, const ScanLayout& layout, const std::vector<PointCounts>& counts) {
    std::size_t n_without_beam = 0, n_late = 0, n_late_scans = 0, latest_frame = 0;
    for (std::size_t i = 0; i < counts.size(); ++i) {
        n_without_beam += counts[i].without_beam;
        n_late += counts[i].late;
        if (counts[i].late > 0) ++n_late_scans;
        if (counts[i].late > counts[latest_frame].late) latest_frame = i;
    }
    if (n_without_beam > 0)
        log.notes.push_back(fmt::format(
            "{} points are skipped, because the fitted sensor has no beam for their rings", n_without_beam));
    if (n_late > 0)
        log.notes.push_back(
            fmt::format("{} points of {} scans are skipped, because their times are outside the sweep of "
                        "their scan, most of them in frame {}",
                        n_late, n_late_scans, log.frames[latest_frame].index));
    for (int l = 0; l < std::ssize(log.lidars); ++l) note_occupied_rays(log, layout, l, counts);
}

}  // namespace relidar::read
