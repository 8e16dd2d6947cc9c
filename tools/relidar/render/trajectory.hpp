// SPDX-License-Identifier: Apache-2.0
// Reads the options --offset, --trajectory, --rate and --times. They define the path of
// the sensor and the times of the scans.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>

namespace CLI {
class App;
}
namespace relidar {
struct Run;
}

namespace relidar::cli {

struct TrajectoryOptions {
    /// empty: the path of the log
    std::string file;
    /// scans per second; no value: the scan rate of the log
    std::optional<double> rate_hz;
    /// "first:last:step" in seconds of the log; empty: evenly spaced at `rate_hz`
    std::string times;
};

/// Adds the options that select a path of the sensor and the times of scans on this path.
void add_path_options(CLI::App& command, TrajectoryOptions& trajectory);

/// Checks that the options for times do not contradict each other.
void check_time_options(const TrajectoryOptions& trajectory, bool has_frames);

/// Parses "x,y,z" or "x,y,z,yaw_deg" in the frame of the sensor.
Pose parse_offset(const std::string& text);

/// @throws UsageError if the rate or the times are invalid, or if a time is outside the
/// trajectory
std::vector<double> scan_times(const TrajectoryOptions& options, const PoseTrack& track, double log_rate_hz);

/// Returns the median height above the ground of a point that moves with the sensor. No
/// value if the log has not observed the ground.
/// @param sensor_path in the world frame of the dataset
std::optional<double> median_height_m(const Run& run, const PoseTrack& sensor_path,
                                      const Pose& sensor_from_point, const std::vector<double>& times_s);

/// Warns if a path leads far from the recorded path, or after the end of the log, when
/// actors do not exist.
void note_leaves_log(const Run& run, const PoseTrack& sensor_track, const std::vector<double>& times_s);

}  // namespace relidar::cli
