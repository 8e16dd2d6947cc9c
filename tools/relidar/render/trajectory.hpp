// SPDX-License-Identifier: Apache-2.0
// Reads the options --offset, --trajectory, --rate and --times. They define the path of
// the sensor and the times of the scans.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

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

/// Parses "x,y,z" or "x,y,z,yaw_deg" in the frame of the sensor.
Pose parse_offset(const std::string& text);

/// @throws UsageError if the rate or the times are invalid, or if a time is outside the
/// trajectory
std::vector<double> scan_times(const TrajectoryOptions& options, const PoseTrack& track, double log_rate_hz);

/// Returns the median height above the ground of a point of a vehicle that follows a
/// path. No value if the log has not observed the ground.
std::optional<double> median_height_m(const Run& run, const PoseTrack& dataset_path);

/// Far from the recorded path, or after the end of the log, when actors do not exist.
void note_leaves_log(const Run& run, const PoseTrack& sensor_track, const std::vector<double>& times_s);

}  // namespace relidar::cli
