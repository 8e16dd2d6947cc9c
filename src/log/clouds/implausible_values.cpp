// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/implausible_values.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "base/median.hpp"
#include "base/parallel.hpp"

namespace relidar::folder {
namespace {

// A vehicle that moves faster, and farther in one step, has wrong poses or times.
constexpr double kFastest_mps = 100.0, kShortestJump_m = 2.0;
// A scan with a smaller share of the usual number of returns is probably incomplete.
constexpr double kLeastReturns = 0.5;
// If the largest intensity of a log is smaller, the scale of the intensities is probably
// wrong. The limit is above 1/255, the result of dividing values of 0 to 1 by 255.
constexpr float kDarkest = 0.005f;
// If a larger share of the returns has the maximum intensity, the scale is probably
// wrong.
constexpr double kMostSaturated = 0.25;

int find_frame_number_at(const LidarSequence& sequence, double time_s) {
    const auto frame = std::ranges::lower_bound(sequence.frames, time_s, {}, &LidarFrame::time_s);
    return frame == sequence.frames.end() ? sequence.frames.back().index : frame->index;
}

void add_note_if_vehicle_is_too_fast(LidarSequence& sequence) {
    const PoseTrack& track = sequence.world_from_vehicle;
    std::size_t n_too_fast = 0, fastest_step = 0;
    double fastest_mps = 0.0;
    for (std::size_t k = 1; k < track.pose.size(); ++k) {
        const double distance_m = glm::distance(track.pose[k].translation, track.pose[k - 1].translation),
                     speed_mps = distance_m / (track.time_s[k] - track.time_s[k - 1]);
        if (!(distance_m > kShortestJump_m && speed_mps > kFastest_mps)) continue;
        ++n_too_fast;
        if (speed_mps <= fastest_mps) continue;
        fastest_mps = speed_mps;
        fastest_step = k;
    }
    if (n_too_fast == 0) return;
    sequence.notes.push_back(fmt::format(
        "the poses or their times are probably wrong: the vehicle moves faster than {} m/s in {} of {} steps "
        "between frames, and at {:.0f} m/s from frame {} to frame {}; expected positions in metres and times "
        "in seconds",
        kFastest_mps, n_too_fast, track.pose.size() - 1, fastest_mps,
        find_frame_number_at(sequence, track.time_s[fastest_step - 1]),
        find_frame_number_at(sequence, track.time_s[fastest_step])));
}

void add_note_about_scans_with_few_returns(LidarSequence& sequence, std::size_t lidar_index) {
    std::vector<std::pair<std::size_t, int>> scans;  // number of returns, number of the frame
    for (const LidarFrame& frame : sequence.frames)
        if (frame.lidar == int(lidar_index)) scans.emplace_back(frame.scan.count_returns(), frame.index);
    if (scans.empty()) return;
    const std::size_t usual = compute_median(scans).first;
    const auto [fewest, frame_number] = *std::ranges::min_element(scans);
    const auto n_small = std::ranges::count_if(
        scans, [&](const auto& scan) { return double(scan.first) < kLeastReturns * double(usual); });
    if (n_small == 0) return;
    const std::string& name = sequence.lidars[lidar_index].name;
    sequence.notes.push_back(fmt::format(
        "{}{} of {} scans have fewer than half of the usual {} returns; frame {} has only {}; check whether "
        "these scans are complete",
        name.empty() ? "" : fmt::format("LiDAR '{}': ", name), n_small, scans.size(), usual, frame_number,
        fewest));
}

/// Intensities of the returns in one scan, or in all scans.
struct IntensityStatistics {
    std::size_t n_returns = 0, n_at_maximum = 0;
    float lowest = INFINITY, highest = -INFINITY;
};

IntensityStatistics compute_intensity_statistics(const LidarSequence& sequence) {
    std::vector<IntensityStatistics> by_frame(sequence.frames.size());
    parallel_for(static_cast<int>(by_frame.size()), [&](int index) {
        const Scan& scan = sequence.frames[std::size_t(index)].scan;
        IntensityStatistics& statistics = by_frame[std::size_t(index)];
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
            if (!(scan.range_m[ray] > 0.0f)) continue;
            ++statistics.n_returns;
            statistics.n_at_maximum += scan.intensity[ray] == 1.0f;
            statistics.lowest = std::min(statistics.lowest, scan.intensity[ray]);
            statistics.highest = std::max(statistics.highest, scan.intensity[ray]);
        }
    });
    IntensityStatistics total;
    for (const IntensityStatistics& statistics : by_frame) {
        total.n_returns += statistics.n_returns;
        total.n_at_maximum += statistics.n_at_maximum;
        total.lowest = std::min(total.lowest, statistics.lowest);
        total.highest = std::max(total.highest, statistics.highest);
    }
    return total;
}

void add_note_if_intensities_are_implausible(LidarSequence& sequence) {
    const IntensityStatistics statistics = compute_intensity_statistics(sequence);
    if (statistics.n_returns == 0) return;
    std::string note;
    if (statistics.lowest == statistics.highest) {
        const bool is_zero = statistics.highest == 0.0f;
        note = fmt::format("all intensities of the log are {}, so rendered intensities have no meaning{}",
                           is_zero ? "0" : fmt::format("{:.4g} of the maximum", statistics.highest),
                           is_zero ? " and are not scored" : "");
    } else if (statistics.highest < kDarkest) {
        note = fmt::format(
            "the scale of the intensities is probably wrong: the largest intensity of the log is {:.2g} of "
            "the maximum",
            statistics.highest);
    } else if (const double share = double(statistics.n_at_maximum) / double(statistics.n_returns);
               share > kMostSaturated) {
        note = fmt::format(
            "the scale of the intensities is probably wrong: {:.0f} % of the returns have the maximum "
            "intensity",
            100.0 * share);
    }
    // A converted log may already have the note.
    if (!note.empty() && std::ranges::find(sequence.notes, note) == sequence.notes.end())
        sequence.notes.push_back(note);
}

}  // namespace

void add_notes_about_implausible_values(LidarSequence& sequence) {
    if (sequence.has_poses) add_note_if_vehicle_is_too_fast(sequence);
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l)
        add_note_about_scans_with_few_returns(sequence, l);
    add_note_if_intensities_are_implausible(sequence);
}

}  // namespace relidar::folder
