// SPDX-License-Identifier: Apache-2.0
// A path of the sensor's own to drive along, and the moments at which scans are taken on
// it.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// --trajectory, --rate and --times.
struct TrajectoryChoice {
    std::string file;  ///< empty: the log's path
    /// scans a second, from the first pose to the last; not given: as the log's sensor
    /// turns
    std::optional<double> rate_hz;
    std::string times;  ///< "first:last:step" in seconds of the log; empty: by the rate
};

/// Moments of the scans. @throws UsageError for a rate or times that make no sense, or
/// lie beyond the trajectory
std::vector<double> scan_times(const TrajectoryChoice& choice, const PoseTrack& track, double log_rate_hz);

/// Says what a user may not expect of a trajectory: poses far from the log's, times at
/// which the log has no actors any more.
void note_beyond_log(const Run& run, const PoseTrack& track, const std::vector<double>& times_s);

}  // namespace relidar::cli
