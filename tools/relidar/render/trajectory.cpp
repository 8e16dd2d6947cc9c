// SPDX-License-Identifier: Apache-2.0
#include "render/trajectory.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/run/edit.hpp>
#include <relidar/run/run.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

constexpr double kMostScans = 1e6;
// The log has hardly observed the scene at this distance from its path.
constexpr double kMaxPathDistance_m = 50.0;
// A larger offset is probably a typing error. Floats have errors of a millimetre there.
constexpr double kFarthestOffset_m = 10'000.0;
// Fraction of a step, so that FIRST:LAST:STEP = 0:1:0.1 includes 1.
constexpr double kStepSlack = 1e-6;

struct TimeSteps {
    double first, last, step;
};

}  // namespace

Pose parse_offset(const std::string& text) {
    if (text.empty()) return {};
    const std::vector<double> v = parse_list("--offset", text);
    if (v.size() != 3 && v.size() != 4)
        fail<UsageError>("--offset: found {} numbers in \"{}\", expected x,y,z or x,y,z,yaw_deg", v.size(),
                         text);
    for (std::size_t i = 0; i < 3; ++i)
        if (std::abs(v[i]) > kFarthestOffset_m) {
            fail<UsageError>("--offset: found {} in \"{}\"; expected a distance in metres between -{} and {}",
                             v[i], text, kFarthestOffset_m, kFarthestOffset_m);
        }
    if (v.size() == 4 && std::abs(v[3]) > 360.0) {
        fail<UsageError>("--offset: found a yaw angle of {} in \"{}\"; expected degrees between -360 and 360",
                         v[3], text);
    }
    const double yaw_rad = v.size() == 4 ? v[3] * kPi / 180.0 : 0.0;
    return {glm::angleAxis(yaw_rad, glm::dvec3(0.0, 0.0, 1.0)), {v[0], v[1], v[2]}};
}

/// Returns the times of the scans on a trajectory, in seconds. They are given by --times
/// or --rate, or by the rate of the log's sensor.
std::vector<double> scan_times(const TrajectoryOptions& options, const PoseTrack& track, double log_rate_hz) {
    const double begin = track.time_s.front(), end = track.time_s.back();
    if (options.rate_hz && !(*options.rate_hz > 0.0 && std::isfinite(*options.rate_hz)))
        fail<UsageError>("--rate: found {}; expected a number of scans per second above 0", *options.rate_hz);
    TimeSteps steps{begin, end, 1.0 / options.rate_hz.value_or(log_rate_hz)};
    if (!options.times.empty()) {
        std::vector<double> numbers;
        for (const std::string& word : split_text(options.times, ':'))
            if (const std::optional<double> number = parse_finite(word)) numbers.push_back(*number);
        if (numbers.size() != 3 || std::ranges::count(options.times, ':') != 2)
            fail<UsageError>(
                "--times: found \"{}\"; expected FIRST:LAST:STEP in seconds, for example 2:4:0.05",
                options.times);
        steps = {numbers[0], numbers[1], numbers[2]};
    }
    if (!(steps.step > 0.0) || !(steps.last >= steps.first))
        fail<UsageError>("--times: found \"{}\"; expected FIRST < LAST and a STEP above 0", options.times);
    const double slack_s = kStepSlack * steps.step;
    if (steps.first < begin - slack_s || steps.last > end + slack_s) {
        fail<UsageError>(
            "--times: found {} to {} s; expected times within those of the trajectory, {} to {} s",
            steps.first, steps.last, begin, end);
    }
    const double n = std::floor((steps.last - steps.first) / steps.step + kStepSlack) + 1.0;
    if (n > kMostScans)
        fail<UsageError>(
            "--trajectory: the options select {:.3g} scans from {} to {} s; expected at most {:.0e} scans", n,
            steps.first, steps.last, kMostScans);
    std::vector<double> times;
    for (int i = 0; i < static_cast<int>(n); ++i) times.push_back(steps.first + i * steps.step);
    return times;
}

std::optional<double> median_height_m(const Run& run, const PoseTrack& dataset_path) {
    constexpr glm::dvec3 kVehicle_m{4.0, 2.0, 0.0};  // area in which the ground is searched
    std::vector<double> heights_m;
    for (const std::optional<double>& height_m :
         heights_above_ground({run.scene, run.sequence}, dataset_path, kVehicle_m))
        if (height_m) heights_m.push_back(*height_m);
    if (heights_m.empty()) return {};
    const auto middle = heights_m.begin() + std::ptrdiff_t(heights_m.size() / 2);
    std::ranges::nth_element(heights_m, middle);
    return *middle;
}

/// Warns if a trajectory leads away from the recorded path, or continues after the end of
/// the log, where actors do not exist.
void note_leaves_log(const Run& run, const PoseTrack& sensor_track, const std::vector<double>& times_s) {
    const Log& log = run.sequence;
    double farthest = 0.0;
    for (const double t : times_s) {
        const glm::dvec3 sensor_m = sensor_track.pose_at(t).translation - log.world_offset_m;
        double nearest_m = std::numeric_limits<double>::infinity();
        for (const Pose& pose : log.world_from_vehicle.pose)
            nearest_m = std::min(nearest_m, glm::distance(pose.translation, sensor_m));
        farthest = std::max(farthest, nearest_m);
    }
    if (farthest > kMaxPathDistance_m) {
        print_warning(fmt::format(
            "the trajectory is up to {:.0f} m away from the path of the log's sensor (`relidar export {}`)",
            farthest, run.folder.string()));
    }
    const double begin = log.frames.front().time_s, end = log.frames.back().time_s;
    // Actors exist for half a time step longer than the log (BoxTrack).
    const double slack_s =
        0.5 * (end - begin) / std::max<double>(1.0, log.world_from_vehicle.time_s.size() - 1.0);
    const auto beyond = std::count_if(times_s.begin(), times_s.end(),
                                      [&](double t) { return t < begin - slack_s || t > end + slack_s; });
    if (beyond > 0 && run.scene.instances.size() > 1)
        print_warning(
            fmt::format("{} of {} scans are outside the time of the log ({} to {} s), so they show no actors",
                        beyond, times_s.size(), begin, end));
}

}  // namespace relidar::cli
