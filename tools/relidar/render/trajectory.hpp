// SPDX-License-Identifier: Apache-2.0
// Reads the options of --trajectory: the path of the sensor, and the times of the scans
// on this path.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// Values of --trajectory, --rate and --times.
struct TrajectoryChoice {
    std::string file;  ///< File with the trajectory. If it is empty, the path of the log is used.
    /// Number of scans per second between the first and the last pose. Without a value,
    /// the rate of the log's sensor is used.
    std::optional<double> rate_hz;
    /// Times of the scans as "first:last:step" in seconds of the log. If it is empty, the
    /// times follow from the rate.
    std::string times;
};

/// Returns the times of the scans on a trajectory.
/// @throws UsageError if the rate or the times are invalid, or if a time is outside the
/// trajectory
std::vector<double> scan_times(const TrajectoryChoice& choice, const PoseTrack& track, double log_rate_hz);

/// Prints notes about a trajectory. A note is printed if the trajectory is far from the
/// path of the log. Another one is printed if it has times after the end of the log,
/// because no actors exist then.
void note_beyond_log(const Run& run, const PoseTrack& track, const std::vector<double>& times_s);

}  // namespace relidar::cli
