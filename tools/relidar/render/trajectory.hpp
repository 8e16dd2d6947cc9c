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

/// Values of --trajectory, --rate and --times.
struct TrajectoryOptions {
    /// File that contains the trajectory. If the name is empty, the sensor follows the
    /// path of the log.
    std::string file;
    /// Number of scans per second between the first and the last pose. Without a value,
    /// the sensor keeps the scan rate of the log.
    std::optional<double> rate_hz;
    /// Times of the scans as "first:last:step", in seconds of the log. If the text is
    /// empty, the scans are evenly spaced at `rate_hz`.
    std::string times;
};

/// Returns the times of the scans on a trajectory.
/// @throws UsageError if the rate or the times are invalid, or if a time is outside the
/// trajectory
std::vector<double> list_scan_times_on_trajectory(const TrajectoryOptions& trajectory_options,
                                                  const PoseTrack& sensor_track, double log_rate_hz);

/// Prints a note if a trajectory is far from the recorded path. Prints another note if it
/// continues after the end of the log, because actors exist only during the log.
void print_notes_if_trajectory_leaves_log(const TrainedRun& run, const PoseTrack& sensor_track,
                                          const std::vector<double>& times_s);

}  // namespace relidar::cli
