// SPDX-License-Identifier: Apache-2.0
// Tests for faults that a log probably has, and for gaps between its frames.
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <numeric>
#include <set>

#include <relidar/base/float_step.hpp>
#include <relidar/log/own_body.hpp>

#include "base/median.hpp"
#include "log/checks/checks.hpp"
#include "log/frames/match_sweeps.hpp"

namespace relidar::checks {
namespace {

// A time step is a gap if it is longer than both; above kMaxGap_s, the clock has jumped.
constexpr double kMinGap_s = 1.0, kMinGapSteps = 10.0, kMaxGap_s = 60.0;
// A vehicle that moves faster, and farther in one step, has wrong poses or times.
constexpr double kMaxSpeed_mps = 100.0, kMinJump_m = 2.0;
// A scan is probably incomplete if it has a smaller share of the median number of returns
// of its neighbours, which are this number of scans before and after it.
constexpr double kMinReturnShare = 0.5;
constexpr std::ptrdiff_t kNeighbourScans = 5;
// If the largest intensity of a LiDAR is smaller, the scale of the intensities is
// probably wrong: RELLIS-3D reaches only 0.0119. Even asphalt reflects about 0.05.
constexpr float kMinBrightest = 0.05f;
constexpr double kMaxSaturatedShare = 0.25;  // of the returns that have the maximum intensity
// Plausible median time between frames, relative to the duration of a sweep. With a wrong
// unit, frames are by a multiple of 1000 farther apart. A log may have a scan every few
// minutes, so milliseconds are assumed only if the frames would then follow each other.
constexpr double kMinSweeps = 0.7, kMaxSweeps = 1.5, kMaxSweepsOfLongSteps = 100.0;
constexpr double kUsualSweep_s = 0.1;  // if the duration of a sweep is unknown
// Coordinates are in single precision if all of them are multiples of its step. A step
// below the first limit does no harm. Fewer different coordinates prove nothing.
constexpr double kMinFloatStep_m = 0.01, kMaxStepError = 1e-4;
constexpr std::size_t kMinCoordinates = 5;
// Fit of the times of rays to a direction of rotation, as |mean of exp(i phase error)|.
constexpr double kMinFit = 0.9, kMaxMisfit = 0.6;
constexpr int kRotationScans = 5;

/// Steps between frames that are much longer than usual.
struct TimeGaps {
    std::size_t n = 0;
    double usual_s = 0.0, longest_s = 0.0;
    int before = 0, after = 0;  ///< numbers of the frames at the longest gap
};

/// Finds the steps between frames that are much longer than the median step.
TimeGaps find_time_gaps(const Log& log) {
    std::vector<double> steps_s;
    TimeGaps gaps;
    for (std::size_t i = 1; i < log.frames.size(); ++i) {
        const Frame &before = log.frames[i - 1], &after = log.frames[i];
        const double step_s = after.time_s - before.time_s;
        if (step_s > 0.0) steps_s.push_back(step_s);
        if (step_s > gaps.longest_s)
            gaps = {.longest_s = step_s, .before = before.index, .after = after.index};
    }
    if (steps_s.empty()) return {};
    std::ranges::sort(steps_s);
    gaps.usual_s = steps_s[(steps_s.size() - 1) / 2];  // median; the lower one of an even number
    const double min_gap_s = std::max(kMinGap_s, kMinGapSteps * gaps.usual_s);
    for (const double step_s : steps_s)
        if (step_s > min_gap_s) ++gaps.n;
    return gaps;
}

/// Returns the duration of a sweep: the period of a LiDAR, or else the time between the
/// first and the last ray of a scan, or else kUsualSweep_s.
double find_sweep_s(const Log& log) {
    for (const Lidar& lidar : log.lidars)
        if (lidar.sweep_period_s() > 0.0) return lidar.sweep_period_s();
    for (const Frame& frame : log.frames) {
        if (frame.scan.rays.size() == 0) continue;
        const auto [first_s, last_s] = std::ranges::minmax(frame.scan.rays.time_offset_s);
        if (last_s > first_s) return double(last_s) - double(first_s);
    }
    return kUsualSweep_s;
}

int find_frame_number(const Log& log, double time_s) {
    const auto frame = std::ranges::lower_bound(log.frames, time_s, {}, &Frame::time_s);
    return frame == log.frames.end() ? log.frames.back().index : frame->index;
}

/// Returns the statistics of all scans of a LiDAR. -1: of all LiDARs
ReturnStatistics add_scans(const CheckedLog& checked, int lidar) {
    ReturnStatistics sum;
    for (std::size_t i = 0; i < checked.scans.size(); ++i)
        if (lidar < 0 || checked.log.frames[i].lidar == lidar) sum.add(checked.scans[i]);
    return sum;
}

bool are_intensities_equal(const CheckedLog& checked) {
    const ReturnStatistics all = add_scans(checked, -1);
    return all.n_returns > 0 && all.lowest == all.highest;
}

/// Returns the median number of returns of a scan and its neighbours on both sides.
std::size_t usual_returns(const std::vector<std::size_t>& n_returns, std::size_t scan) {
    const auto at = n_returns.begin() + std::ptrdiff_t(scan);
    const auto first = at - std::min(kNeighbourScans, at - n_returns.begin());
    const auto end = at + 1 + std::min(kNeighbourScans, n_returns.end() - at - 1);
    return compute_median(std::vector(first, end));
}

/// Fit of the times of rays to both directions of rotation.
struct RotationFit {
    double nominal = 0.0, opposite = 0.0;  ///< 1: perfect
};

/// Returns how well the returns of a scan fit each direction of rotation. If the head
/// turns in a direction, azimuth minus rotation since time 0 is the same for all rays.
/// The fit is the length of the mean of unit vectors with these angles.
/// @param n_returns  number of returns of the scan
RotationFit measure_rotation(const Scan& scan, const SpinningSensor& sensor, std::size_t n_returns) {
    std::complex<double> nominal, opposite;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const glm::vec3& direction = scan.rays.direction[ray];
        const double azimuth_rad = std::atan2(double(direction.y), double(direction.x)),
                     turned_rad = (sensor.clockwise ? -2.0 : 2.0) * kPi *
                                  double(scan.rays.time_offset_s[ray]) / sensor.period_s;
        nominal += std::polar(1.0, azimuth_rad - turned_rad);
        opposite += std::polar(1.0, azimuth_rad + turned_rad);
    }
    return {std::abs(nominal) / double(n_returns), std::abs(opposite) / double(n_returns)};
}

}  // namespace

void test_clock_jump(const CheckedLog& checked, const FaultReport& report) {
    if (const TimeGaps gaps = find_time_gaps(checked.log); gaps.n > 0 && gaps.longest_s > kMaxGap_s)
        report.add(gaps.after, gaps.longest_s, gaps.before, kMaxGap_s, gaps.usual_s);
}

void test_time_gaps(const CheckedLog& checked, const FaultReport& report) {
    if (const TimeGaps gaps = find_time_gaps(checked.log); gaps.n > 0)
        report.add(gaps.n, gaps.longest_s, gaps.before, gaps.after, gaps.usual_s);
}

/// Reports times that are probably not in seconds. Milliseconds that are read as seconds,
/// for example, put frames 1000 times too far apart. Reports the first unit in which the
/// median step between frames is about the duration of a sweep.
void test_time_unit(const CheckedLog& checked, const FaultReport& report) {
    const std::vector<double>& times_s = checked.log.world_from_vehicle.time_s;
    if (times_s.size() < 2) return;
    const double step_s = median_interval_s(times_s), sweep_s = find_sweep_s(checked.log);
    double units_per_second = 1.0;
    for (const char* unit : {"milliseconds", "microseconds", "nanoseconds"}) {
        units_per_second *= 1000.0;
        // Number of sweeps from one frame to the next, if the times have this unit.
        const double n_sweeps = step_s / units_per_second / sweep_s;
        // A step of 100 is 100 ms, or 100 s in a log with a scan every few minutes. So
        // milliseconds need a step of about one sweep. With smaller units, the step in
        // seconds would be a day or more, so longer steps count, too.
        const bool is_milliseconds = units_per_second == 1000.0;
        const double max_sweeps = is_milliseconds ? kMaxSweeps : kMaxSweepsOfLongSteps;
        if (n_sweeps < kMinSweeps || n_sweeps > max_sweeps) continue;
        report.add(step_s, sweep_s, unit);
        return;
    }
}

/// Reports steps of the vehicle that are too fast, and the frames of the fastest one.
/// Short steps do not count, because noise dominates their speed.
void test_speed(const CheckedLog& checked, const FaultReport& report) {
    const auto& [time_s, pose] = checked.log.world_from_vehicle;
    if (!checked.log.has_poses) return;
    std::size_t n_too_fast = 0, fastest = 0;
    double fastest_mps = 0.0;
    for (std::size_t k = 1; k < pose.size(); ++k) {
        const double distance_m = glm::distance(pose[k].translation, pose[k - 1].translation),
                     speed_mps = distance_m / (time_s[k] - time_s[k - 1]);
        if (!(distance_m > kMinJump_m && speed_mps > kMaxSpeed_mps)) continue;
        ++n_too_fast;
        if (speed_mps <= fastest_mps) continue;
        fastest_mps = speed_mps;
        fastest = k;
    }
    if (n_too_fast > 0)
        report.add(kMaxSpeed_mps, n_too_fast, pose.size() - 1, fastest_mps,
                   find_frame_number(checked.log, time_s[fastest - 1]),
                   find_frame_number(checked.log, time_s[fastest]));
}

/// Reports x or y coordinates that were rounded to single precision. Each is then a
/// multiple of the distance between neighbouring floats of its size. Few different
/// coordinates show nothing. Reports the step of the last and the largest coordinate.
void test_float_positions(const CheckedLog& checked, const FaultReport& report) {
    for (int axis = 0; axis < 2 && checked.log.has_poses; ++axis) {
        std::set<double> coordinates_m;  // rounded to multiples, without duplicates
        double step_m = 0.0;
        bool is_rounded = true;
        for (const Pose& pose : checked.log.world_from_vehicle.pose) {
            const double value_m = pose.translation[axis] + checked.log.world_offset_m[axis];
            step_m = float_step_m(value_m);
            const double n_steps = value_m / step_m;
            is_rounded = is_rounded && step_m > kMinFloatStep_m &&
                         std::abs(n_steps - std::round(n_steps)) < kMaxStepError;
            coordinates_m.insert(std::round(n_steps) * step_m);
        }
        if (is_rounded && coordinates_m.size() >= kMinCoordinates)
            return report.add(axis == 0 ? "x" : "y", step_m, *coordinates_m.rbegin());
    }
}

/// Reports the number of scans of each LiDAR with far fewer returns than the median of
/// their neighbours, and the scan with the fewest returns.
void test_few_returns(const CheckedLog& checked, const FaultReport& report) {
    for (std::size_t l = 0; l < checked.log.lidars.size(); ++l) {
        std::vector<const Frame*> frames;    // of this LiDAR
        std::vector<std::size_t> n_returns;  // [frames]
        for (std::size_t i = 0; i < checked.scans.size(); ++i) {
            if (checked.log.frames[i].lidar != int(l)) continue;
            frames.push_back(&checked.log.frames[i]);
            n_returns.push_back(checked.scans[i].n_returns);
        }
        // A program may have read only some scans, so that they have no neighbours.
        if (std::ranges::any_of(frames, [](const Frame* f) { return f->scan.rays.rows == 0; })) continue;
        std::vector<std::size_t> incomplete;  // indices in `frames`
        for (std::size_t k = 0; k < frames.size(); ++k)
            if (double(n_returns[k]) < kMinReturnShare * double(usual_returns(n_returns, k)))
                incomplete.push_back(k);
        if (incomplete.empty()) continue;
        const std::size_t worst =
            *std::ranges::min_element(incomplete, {}, [&](std::size_t k) { return n_returns[k]; });
        report.add_for(int(l), incomplete.size(), frames.size(), frames[worst]->index, n_returns[worst],
                       usual_returns(n_returns, worst));
    }
}

void test_equal_intensities(const CheckedLog& checked, const FaultReport& report) {
    if (are_intensities_equal(checked)) report.add(add_scans(checked, -1).highest);
}

void test_dark(const CheckedLog& checked, const FaultReport& report) {
    for (int l = 0; l < std::ssize(checked.log.lidars) && !are_intensities_equal(checked); ++l)
        if (const float highest = add_scans(checked, l).highest; highest >= 0.0f && highest < kMinBrightest)
            report.add_for(l, highest);
}

void test_saturated(const CheckedLog& checked, const FaultReport& report) {
    for (int l = 0; l < std::ssize(checked.log.lidars) && !are_intensities_equal(checked); ++l) {
        const ReturnStatistics sum = add_scans(checked, l);
        const double share = double(sum.n_at_maximum) / double(std::max<std::size_t>(sum.n_returns, 1));
        if (share > kMaxSaturatedShare) report.add_for(l, 100.0 * share);
    }
}

/// Reports LiDARs whose first scans fit only the opposite direction of rotation. The fit
/// of a direction is 1 if azimuths and times agree with it (measure_rotation()).
void test_rotation(const CheckedLog& checked, const FaultReport& report) {
    for (std::size_t l = 0; l < checked.log.lidars.size(); ++l) {
        const Lidar& lidar = checked.log.lidars[l];
        if (lidar.pattern || lidar.sensor.beams.empty() || !(lidar.sensor.period_s > 0.0)) continue;
        RotationFit sum;
        int n_scans = 0;
        for (std::size_t i = 0; i < checked.scans.size() && n_scans < kRotationScans; ++i) {
            const Frame& frame = checked.log.frames[i];
            if (frame.lidar != int(l) || checked.scans[i].n_returns == 0) continue;
            ++n_scans;
            const RotationFit fit = measure_rotation(frame.scan, lidar.sensor, checked.scans[i].n_returns);
            sum.nominal += fit.nominal;
            sum.opposite += fit.opposite;
        }
        const bool is_opposite = sum.opposite >= kMinFit * n_scans && sum.nominal <= kMaxMisfit * n_scans;
        const char *nominal = "clockwise", *measured = "counterclockwise";
        if (!lidar.sensor.clockwise) std::swap(nominal, measured);
        if (n_scans > 0 && is_opposite) report.add_for(int(l), measured, nominal);
    }
}

void test_own_body(const CheckedLog& checked, const FaultReport& report) {
    std::vector<int> frames(checked.log.frames.size());
    std::iota(frames.begin(), frames.end(), 0);
    for (int l = 0; l < std::ssize(checked.log.lidars) && checked.log.has_poses; ++l)
        if (const OwnBody body = find_own_body(checked.log, l, frames); !body.table.empty())
            report.add_for(l, body.describe());
}

void test_box_convention(const CheckedLog& checked, const FaultReport& report) {
    if (const std::string fault = checks::describe_fault(checked.log); !fault.empty()) report.add(fault);
}

}  // namespace relidar::checks
