// SPDX-License-Identifier: Apache-2.0
// Handles --trajectory: a user's path of the sensor, and the times at which scans are
// taken on it.
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
    std::string file;  ///< Empty: the path of the log.
    /// Scans per second, from the first pose to the last. Default: the rate of the log's
    /// sensor.
    std::optional<double> rate_hz;
    std::string times;  ///< "first:last:step" in seconds of the log. Empty: computed from the rate.
};

/// Returns the times of the scans.
/// @throws UsageError if the rate or the times are invalid, or the times are outside the
/// trajectory
std::vector<double> scan_times(const TrajectoryChoice& choice, const PoseTrack& track, double log_rate_hz);

/// Prints notes about a trajectory that is far from the log's path, or has times after
/// the end of the log, when no actors exist.
void note_beyond_log(const Run& run, const PoseTrack& track, const std::vector<double>& times_s);

}  // namespace relidar::cli
