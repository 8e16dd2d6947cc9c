// SPDX-License-Identifier: Apache-2.0
// Reads the options --trajectory, --rate and --times. They define the path of the sensor
// and the times of the scans.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {
struct TrainedRun;
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

/// @throws UsageError if the rate or the times are invalid, or if a time is outside the
/// trajectory
std::vector<double> list_scan_times_on_trajectory(const TrajectoryOptions& trajectory_options,
                                                  const PoseTrack& sensor_track, double log_rate_hz);

/// Far from the recorded path, or after the end of the log, when actors do not exist.
void print_notes_if_trajectory_leaves_log(const TrainedRun& run, const PoseTrack& sensor_track,
                                          const std::vector<double>& times_s);

}  // namespace relidar::cli
