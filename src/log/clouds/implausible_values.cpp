// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/implausible_values.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <set>
#include <string>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/float_step.hpp>
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "log/clouds/box_conventions.hpp"
#include "log/clouds/match_sweeps.hpp"

namespace relidar::folder {
namespace {

// A vehicle that moves faster, and farther in one step, has wrong poses or times.
constexpr double kFastest_mps = 100.0, kShortestJump_m = 2.0;
// A scan is probably incomplete if it has a smaller share of the median number of returns
// of its neighbours. This number of scans before and after it are neighbours.
constexpr double kLeastReturns = 0.5;
constexpr std::ptrdiff_t kNeighbours = 5;
// If the largest intensity of a LiDAR is smaller, the scale of the intensities is
// probably wrong. The limit is above 1/255, the result of dividing values of 0 to 1 by
// 255.
constexpr float kDarkest = 0.005f;
// If a larger share of the returns has the maximum intensity, the scale is probably
// wrong.
constexpr double kMostSaturated = 0.25;
// A longer box, or a box that is farther in time from the log, probably has a wrong unit.
constexpr double kLongestBox_m = 200.0, kFarTime_s = 3600.0;

// Plausible median time between frames, relative to the duration of a sweep. With a wrong
// unit, frames are by a multiple of 1000 farther apart. A log may have a scan every few
// minutes, so milliseconds are assumed only if the frames would then follow each other.
constexpr double kLeastSweeps = 0.7, kMostSweeps = 1.5, kMostSweepsOfLongSteps = 100.0;
constexpr double kLeastStepSweeps = 0.5;  // sweeps between the scans of a LiDAR
constexpr double kUsualSweep_s = 0.1;     // if the duration of a sweep is unknown
// Coordinates are in single precision if all of them are multiples of its step. A step
// below the first limit does no harm. Fewer different coordinates prove nothing.
constexpr double kLeastStep_m = 0.01, kSameStep = 1e-4;
constexpr std::size_t kFewestCoordinates = 5;

constexpr const char* kSpeedNote = "the poses or their times are probably wrong: ";
constexpr const char* kReturnsNote = "some scans are probably incomplete: ";
constexpr const char* kScaleNote = "the scale of the intensities is probably wrong: ";
constexpr const char* kEqualNote = "all intensities of the log are ";
constexpr const char* kBoxNote = "the boxes are probably wrong: ";
constexpr const char* kUnitNote = "the unit of the times is probably wrong: ";
constexpr const char* kFloatNote = "the positions of the vehicle have lost their precision: ";
constexpr const char* kRotationNote = "the direction of rotation is probably wrong: ";

/// Returns " of LiDAR 'NAME'", or an empty text if the LiDAR has no name.
std::string format_of_lidar(const Lidar& lidar) {
    return lidar.name.empty() ? "" : " of LiDAR '" + lidar.name + "'";
}

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
    sequence.notes.push_back(
        Note("speed", -1,
             kSpeedNote +
                 fmt::format(
                     "the vehicle moves faster than {} m/s in {} of {} steps between frames, and at {:.0f} "
                     "m/s from frame {} to frame {}; expected positions in metres and times in seconds",
                     kFastest_mps, n_too_fast, track.pose.size() - 1, fastest_mps,
                     find_frame_number_at(sequence, track.time_s[fastest_step - 1]),
                     find_frame_number_at(sequence, track.time_s[fastest_step]))));
}

/// Returns the duration of a sweep. Without a known period, returns the time between the
/// first and the last ray of a scan.
double find_sweep_duration_s(const LidarSequence& sequence) {
    for (const Lidar& lidar : sequence.lidars)
        if (lidar.get_sweep_period_s() > 0.0) return lidar.get_sweep_period_s();
    for (const LidarFrame& frame : sequence.frames) {
        if (frame.scan.rays.size() == 0) continue;
        const auto [first_s, last_s] = std::ranges::minmax(frame.scan.rays.time_offset_s);
        if (last_s > first_s) return double(last_s) - double(first_s);
    }
    return kUsualSweep_s;
}

void add_time_unit_note(LidarSequence& sequence) {
    const std::vector<double>& times_s = sequence.world_from_vehicle.time_s;
    if (times_s.size() < 2) return;
    const double step_s = compute_median_interval_s(times_s), sweep_s = find_sweep_duration_s(sequence);
    double per_second = 1.0;
    for (const char* unit : {"milliseconds", "microseconds", "nanoseconds"}) {
        per_second *= 1000.0;
        const double n_sweeps = step_s / per_second / sweep_s;
        if (n_sweeps < kLeastSweeps ||
            n_sweeps > (per_second > 1000.0 ? kMostSweepsOfLongSteps : kMostSweeps))
            continue;
        sequence.notes.push_back(
            Note("time_unit", -1,
                 kUnitNote + fmt::format("frames are {:.6g} s apart, but a sweep takes {:.3g} s; the "
                                         "times of frames seem to be in {}, expected seconds",
                                         step_s, sweep_s, unit)));
        return;
    }
}

/// Adds a note if the scans of a LiDAR follow each other faster than it can measure them.
void add_overlap_note(LidarSequence& sequence, std::size_t lidar) {
    std::vector<double> times_s;
    double sweep_s = 0.0;
    for (const LidarFrame& frame : sequence.frames) {
        if (std::size_t(frame.lidar) != lidar || frame.scan.rays.size() == 0) continue;
        const auto [first_s, last_s] = std::ranges::minmax(frame.scan.rays.time_offset_s);
        if (times_s.empty()) sweep_s = double(last_s) - double(first_s);
        times_s.push_back(frame.time_s);
    }
    if (times_s.size() < 2) return;
    const double step_s = compute_median_interval_s(times_s);
    if (step_s >= kLeastStepSweeps * sweep_s) return;
    sequence.notes.push_back(
        Note("time_unit", -1,
             kUnitNote + fmt::format("scans{} are {:.3g} s apart, but the rays of a scan take {:.3g} s; "
                                     "expected times of frames in seconds, or the rate of the scans",
                                     format_of_lidar(sequence.lidars[lidar]), step_s, sweep_s)));
}

void add_rounding_note(LidarSequence& sequence) {
    for (int axis = 0; axis < 2; ++axis) {
        std::set<double> different_m;
        double step_m = 0.0;
        bool is_rounded = true;
        for (const Pose& pose : sequence.world_from_vehicle.pose) {
            const double value_m = pose.translation[axis] + sequence.world_offset_m[axis];
            step_m = compute_float_step_m(value_m);
            const double n_steps = value_m / step_m;
            is_rounded =
                is_rounded && step_m > kLeastStep_m && std::abs(n_steps - std::round(n_steps)) < kSameStep;
            different_m.insert(std::round(n_steps) * step_m);
        }
        if (!is_rounded || different_m.size() < kFewestCoordinates) continue;
        sequence.notes.push_back(
            Note("float_positions", -1,
                 kFloatNote + fmt::format("all {} coordinates are multiples of {:.3g} m, which is the "
                                          "precision of float32 at {:.0f} m; expected double precision",
                                          axis == 0 ? "x" : "y", step_m, *different_m.rbegin())));
        return;
    }
}

/// Returns in one scan, or in several scans, and their intensities.
struct ReturnStatistics {
    std::size_t n_returns = 0, n_at_maximum = 0;
    float lowest = INFINITY, highest = -INFINITY;

    void add(const ReturnStatistics& other) {
        n_returns += other.n_returns;
        n_at_maximum += other.n_at_maximum;
        lowest = std::min(lowest, other.lowest);
        highest = std::max(highest, other.highest);
    }
};

/// Returns the statistics of the first returns of each frame.
std::vector<ReturnStatistics> compute_statistics_of_frames(const LidarSequence& sequence) {
    std::vector<ReturnStatistics> by_frame(sequence.frames.size());
    parallel_for(static_cast<int>(by_frame.size()), [&](int index) {
        const Scan& scan = sequence.frames[std::size_t(index)].scan;
        ReturnStatistics& statistics = by_frame[std::size_t(index)];
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
            if (!(scan.range_m[ray] > 0.0f)) continue;
            ++statistics.n_returns;
            statistics.n_at_maximum += scan.intensity[ray] == 1.0f;
            statistics.lowest = std::min(statistics.lowest, scan.intensity[ray]);
            statistics.highest = std::max(statistics.highest, scan.intensity[ray]);
        }
    });
    return by_frame;
}

void add_note_about_scans_with_few_returns(LidarSequence& sequence,
                                           const std::vector<ReturnStatistics>& by_frame,
                                           std::size_t lidar_index) {
    std::vector<std::size_t> n_returns;
    std::vector<int> frame_numbers;
    for (std::size_t i = 0; i < by_frame.size(); ++i) {
        const LidarFrame& frame = sequence.frames[i];
        if (frame.lidar != int(lidar_index)) continue;
        // If only a few scans of the log are read, they are no neighbours.
        if (frame.scan.rays.rows == 0) return;
        n_returns.push_back(by_frame[i].n_returns);
        frame_numbers.push_back(frame.index);
    }
    std::size_t n_small = 0, worst = 0, usual_of_worst = 0;
    for (std::size_t k = 0; k < n_returns.size(); ++k) {
        const auto at = n_returns.begin() + std::ptrdiff_t(k);
        const std::size_t usual =
            compute_median(std::vector(at - std::min(kNeighbours, at - n_returns.begin()),
                                       at + 1 + std::min(kNeighbours, n_returns.end() - at - 1)));
        if (double(*at) >= kLeastReturns * double(usual)) continue;
        if (n_small++ > 0 && *at >= n_returns[worst]) continue;
        worst = k;
        usual_of_worst = usual;
    }
    if (n_small == 0) return;
    sequence.notes.push_back(Note(
        "few_returns", -1,
        kReturnsNote + fmt::format("{} of {} scans{} have fewer than half of the returns of neighbouring "
                                   "scans; frame {} has only {} instead of about {}",
                                   n_small, n_returns.size(), format_of_lidar(sequence.lidars[lidar_index]),
                                   frame_numbers[worst], n_returns[worst], usual_of_worst)));
}

/// Returns a note if the intensities probably have a wrong scale. Otherwise returns an
/// empty text.
std::string describe_implausible_scale(const ReturnStatistics& statistics, const Lidar& lidar) {
    if (statistics.n_returns == 0) return "";
    const std::string of_lidar = format_of_lidar(lidar);
    if (statistics.highest == 0.0f) return kScaleNote + fmt::format("all intensities{} are 0", of_lidar);
    if (statistics.highest < kDarkest)
        return kScaleNote +
               fmt::format("the largest intensity{} is {:.2g} of the maximum", of_lidar, statistics.highest);
    const double share = double(statistics.n_at_maximum) / double(statistics.n_returns);
    if (share <= kMostSaturated) return "";
    return kScaleNote +
           fmt::format("{:.0f} % of the returns{} have the maximum intensity", 100.0 * share, of_lidar);
}

void add_notes_about_intensities(LidarSequence& sequence, const std::vector<ReturnStatistics>& by_frame) {
    ReturnStatistics of_log;
    std::vector<ReturnStatistics> by_lidar(sequence.lidars.size());
    for (std::size_t i = 0; i < by_frame.size(); ++i) {
        of_log.add(by_frame[i]);
        by_lidar[std::size_t(sequence.frames[i].lidar)].add(by_frame[i]);
    }
    if (of_log.n_returns > 0 && of_log.lowest == of_log.highest) {
        const bool is_zero = of_log.highest == 0.0f;
        sequence.notes.push_back(Note(
            "equal_intensities", -1,
            kEqualNote + fmt::format("{}, so rendered intensities have no meaning{}",
                                     is_zero ? "0" : fmt::format("{:.4g} of the maximum", of_log.highest),
                                     is_zero ? " and are not scored" : "")));
        return;
    }
    for (std::size_t l = 0; l < by_lidar.size(); ++l)
        if (const std::string note = describe_implausible_scale(by_lidar[l], sequence.lidars[l]);
            !note.empty())
            sequence.notes.push_back(Note("intensity_scale", int(l), note));
}

/// Adds a note if the times of the rays show that the head of a spinning LiDAR turns
/// against the direction of its sensor. Compares |mean of exp(i (azimuth -+ 2 pi t /
/// period))|, which is 1 for the direction in which the head turns.
void add_note_about_rotation(LidarSequence& sequence, std::size_t lidar_index) {
    constexpr double kLeastFit = 0.9, kLargestMisfit = 0.6;
    constexpr int kMostScans = 5;
    const Lidar& lidar = sequence.lidars[lidar_index];
    if (lidar.pattern || lidar.sensor.beams.empty() || !(lidar.sensor.period_s > 0.0)) return;
    std::array<double, 2> fit{};  // of the direction of the sensor, and of the other direction
    int n_scans = 0;
    for (const LidarFrame& frame : sequence.frames) {
        if (frame.lidar != int(lidar_index) || frame.scan.count_returns() == 0 || n_scans == kMostScans)
            continue;
        ++n_scans;
        std::array<std::complex<double>, 2> sums{};
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
            if (!(frame.scan.range_m[ray] > 0.0f)) continue;
            const glm::vec3& d = frame.scan.rays.direction[ray];
            const double turned_rad = (lidar.sensor.clockwise ? -2.0 : 2.0) * kPi *
                                      double(frame.scan.rays.time_offset_s[ray]) / lidar.sensor.period_s;
            sums[0] += std::polar(1.0, std::atan2(double(d.y), double(d.x)) - turned_rad);
            sums[1] += std::polar(1.0, std::atan2(double(d.y), double(d.x)) + turned_rad);
        }
        for (std::size_t k = 0; k < 2; ++k) fit[k] += std::abs(sums[k]) / double(frame.scan.count_returns());
    }
    if (n_scans == 0 || fit[1] < kLeastFit * n_scans || fit[0] > kLargestMisfit * n_scans) return;
    const char *clockwise = "clockwise", *counterclockwise = "counterclockwise";
    sequence.notes.push_back(
        Note("rotation", -1,
             kRotationNote + fmt::format("by the times of the points, the head{} turns {}, but its sensor "
                                         "turns {}; check the sign of the times and of y",
                                         format_of_lidar(lidar),
                                         lidar.sensor.clockwise ? counterclockwise : clockwise,
                                         lidar.sensor.clockwise ? clockwise : counterclockwise)));
}

void add_notes_about_boxes(LidarSequence& sequence) {
    const PoseTrack& vehicle = sequence.world_from_vehicle;
    std::size_t n_far_in_time = 0;
    const BoxTrack* largest = nullptr;
    const auto get_length_m = [](const BoxTrack& box) {
        return std::max({box.size_m.x, box.size_m.y, box.size_m.z});
    };
    for (const BoxTrack& box : sequence.boxes) {
        n_far_in_time += box.world_from_box.time_s.front() > vehicle.time_s.back() + kFarTime_s ||
                         box.world_from_box.time_s.back() < vehicle.time_s.front() - kFarTime_s;
        if (get_length_m(box) > kLongestBox_m && (!largest || get_length_m(box) > get_length_m(*largest)))
            largest = &box;
    }
    if (n_far_in_time > 0)
        sequence.notes.push_back(
            Note("boxes", -1,
                 kBoxNote + fmt::format("the times of {} of {} boxes are more than an hour before or "
                                        "after the log; expected seconds on the clock of the scans",
                                        n_far_in_time, sequence.boxes.size())));
    if (largest)
        sequence.notes.push_back(Note("boxes", -1,
                                      kBoxNote + fmt::format("the box '{}' is {:.0f} m long; expected metres",
                                                             largest->id, get_length_m(*largest))));
    if (const std::string fault = describe_box_fault(sequence); !fault.empty())
        sequence.notes.push_back(Note("boxes", -1, kBoxNote + fault));
}

}  // namespace

void add_notes_about_implausible_values(LidarSequence& sequence) {
    add_time_unit_note(sequence);
    if (sequence.has_poses) {
        add_note_if_vehicle_is_too_fast(sequence);
        add_rounding_note(sequence);
    }
    const std::vector<ReturnStatistics> by_frame = compute_statistics_of_frames(sequence);
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l)
        add_note_about_scans_with_few_returns(sequence, by_frame, l);
    for (std::size_t l = 0; l < sequence.lidars.size(); ++l) {
        add_note_about_rotation(sequence, l);
        add_overlap_note(sequence, l);
    }
    add_notes_about_intensities(sequence, by_frame);
    add_notes_about_boxes(sequence);
}

}  // namespace relidar::folder
