// SPDX-License-Identifier: Apache-2.0
#include "render/trajectory.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

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
    double first, last, step;  ///< seconds
};

/// Parses the value "FIRST:LAST:STEP" of --times.
TimeSteps parse_times(const std::string& text) {
    std::vector<double> numbers;
    for (const std::string& word : split_text(text, ':'))
        if (const std::optional<double> number = parse_finite(word)) numbers.push_back(*number);
    if (numbers.size() != 3 || std::ranges::count(text, ':') != 2)
        fail<UsageError>("--times: found \"{}\"; expected FIRST:LAST:STEP in seconds, for example 2:4:0.05",
                         text);
    return {.first = numbers[0], .last = numbers[1], .step = numbers[2]};
}

/// Returns the largest distance of the sensor from the recorded path, over some times.
double max_distance_m(const Log& log, const PoseTrack& sensor_track, const std::vector<double>& times_s) {
    double farthest_m = 0.0;
    for (const double time_s : times_s) {
        const glm::dvec3 sensor_m = sensor_track.pose_at(time_s).translation - log.world_offset_m;
        double nearest_m = std::numeric_limits<double>::infinity();
        for (const Pose& pose : log.world_from_vehicle.pose)
            nearest_m = std::min(nearest_m, glm::distance(pose.translation, sensor_m));
        farthest_m = std::max(farthest_m, nearest_m);
    }
    return farthest_m;
}

}  // namespace

void add_path_options(CLI::App& command, TrajectoryOptions& trajectory) {
    add_option(command, "--trajectory FILE.csv", trajectory.file,
               "move the sensor along this path: lines of time_s,x,y,z,yaw_deg[,pitch_deg,roll_deg] in the "
               "dataset's world and the log's time, or with latitude_deg,longitude_deg,height_m in the run's "
               "georeference; `relidar export RUN --out FILE.csv` writes the path of the log; --offset "
               "shifts the sensor from the path; rays have the nominal angles of the sensor, unlike those of "
               "--frames, which repeat a recorded scan");
    add_option(command, "--rate HZ", trajectory.rate_hz,
               "scans per second on the trajectory (default: the rate of the log's sensor)");
    add_option(command, "--times FIRST:LAST:STEP", trajectory.times,
               "times of the scans on the trajectory, instead of --rate: first, last and step in seconds");
}

void check_time_options(const TrajectoryOptions& trajectory, bool has_frames) {
    const bool has_path = !trajectory.file.empty(), has_times = !trajectory.times.empty();
    if (!has_path && (trajectory.rate_hz || has_times))
        throw UsageError("--rate and --times need --trajectory, because they select times on a trajectory");
    if (has_path && has_frames)
        throw UsageError(
            "--frames and --trajectory cannot be used together; use --times to select times on a trajectory");
    if (trajectory.rate_hz && has_times) throw UsageError("--rate and --times cannot be used together");
}

Pose parse_offset(const std::string& text) {
    if (text.empty()) return {};
    const std::vector<double> numbers = parse_list("--offset", text);
    if (numbers.size() != 3 && numbers.size() != 4)
        fail<UsageError>("--offset: found {} numbers in \"{}\", expected x,y,z or x,y,z,yaw_deg",
                         numbers.size(), text);
    const glm::dvec3 offset_m(numbers[0], numbers[1], numbers[2]);
    for (int axis = 0; axis < 3; ++axis)
        if (std::abs(offset_m[axis]) > kFarthestOffset_m)
            fail<UsageError>("--offset: found {} in \"{}\"; expected a distance in metres between -{} and {}",
                             offset_m[axis], text, kFarthestOffset_m, kFarthestOffset_m);
    const double yaw_deg = numbers.size() == 4 ? numbers[3] : 0.0;
    if (std::abs(yaw_deg) > 360.0)
        fail<UsageError>("--offset: found a yaw angle of {} in \"{}\"; expected degrees between -360 and 360",
                         yaw_deg, text);
    return {glm::angleAxis(yaw_deg * kPi / 180.0, glm::dvec3(0.0, 0.0, 1.0)), offset_m};
}

/// Returns the times of the scans on a trajectory, in seconds. They are given by --times
/// or --rate, or by the rate of the log's sensor.
std::vector<double> scan_times(const TrajectoryOptions& options, const PoseTrack& track, double log_rate_hz) {
    const double begin = track.time_s.front(), end = track.time_s.back();
    if (options.rate_hz && !(*options.rate_hz > 0.0 && std::isfinite(*options.rate_hz)))
        fail<UsageError>("--rate: found {}; expected a number of scans per second above 0", *options.rate_hz);
    TimeSteps steps{begin, end, 1.0 / options.rate_hz.value_or(log_rate_hz)};
    if (!options.times.empty()) steps = parse_times(options.times);
    // Negated comparisons, so that NaN is rejected too.
    if (!(steps.step > 0.0) || !(steps.last >= steps.first))
        fail<UsageError>("--times: found \"{}\"; expected FIRST < LAST and a STEP above 0", options.times);
    const double slack_s = kStepSlack * steps.step;  // for rounding errors of the times
    if (steps.first < begin - slack_s || steps.last > end + slack_s) {
        fail<UsageError>(
            "--times: found {} to {} s; expected times within those of the trajectory, {} to {} s",
            steps.first, steps.last, begin, end);
    }
    // A scan at the first time, and one after each complete step.
    const double n_scans = std::floor((steps.last - steps.first) / steps.step + kStepSlack) + 1.0;
    if (n_scans > kMostScans)
        fail<UsageError>(
            "--trajectory: the options select {:.3g} scans from {} to {} s; expected at most {:.0e} scans",
            n_scans, steps.first, steps.last, kMostScans);
    std::vector<double> times_s;
    for (int i = 0; i < static_cast<int>(n_scans); ++i) times_s.push_back(steps.first + i * steps.step);
    return times_s;
}

std::optional<double> median_height_m(const Run& run, const PoseTrack& sensor_path,
                                      const Pose& sensor_from_point, const std::vector<double>& times_s) {
    PoseTrack point_path;
    for (const double time_s : times_s)
        point_path.pose.push_back(sensor_path.pose_at(time_s) * sensor_from_point);
    constexpr glm::dvec3 kVehicle_m{4.0, 2.0, 0.0};  // area in which the ground is searched
    std::vector<double> heights_m;
    for (const std::optional<double>& height_m :
         heights_above_ground({run.scene, run.log}, point_path, kVehicle_m))
        if (height_m) heights_m.push_back(*height_m);
    if (heights_m.empty()) return {};
    const auto middle = heights_m.begin() + std::ptrdiff_t(heights_m.size() / 2);
    std::ranges::nth_element(heights_m, middle);
    return *middle;
}

void note_leaves_log(const Run& run, const PoseTrack& sensor_track, const std::vector<double>& times_s) {
    const Log& log = run.log;
    const double distance_m = max_distance_m(log, sensor_track, times_s);
    if (distance_m > kMaxPathDistance_m)
        print_warning(fmt::format(
            "the trajectory is up to {:.0f} m away from the path of the log's sensor (`relidar export {}`)",
            distance_m, run.folder.string()));
    const double begin_s = log.frames.front().time_s, end_s = log.frames.back().time_s;
    // Actors exist for half a time step longer than the log, at both ends (BoxTrack).
    const double n_steps = std::max<double>(1.0, log.world_from_vehicle.time_s.size() - 1.0);
    const double half_step_s = 0.5 * (end_s - begin_s) / n_steps;
    const auto n_outside = std::ranges::count_if(times_s, [&](double time_s) {
        return time_s < begin_s - half_step_s || time_s > end_s + half_step_s;
    });
    const bool has_actors = run.scene.instances.size() > 1;  // besides the background
    if (n_outside > 0 && has_actors)
        print_warning(
            fmt::format("{} of {} scans are outside the time of the log ({} to {} s), so they show no actors",
                        n_outside, times_s.size(), begin_s, end_s));
}

}  // namespace relidar::cli
