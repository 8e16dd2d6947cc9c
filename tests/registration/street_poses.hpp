// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <relidar/log/log.hpp>

#include "read/datasets/street/street.hpp"

namespace relidar::test {

inline constexpr double kDegree = kPi / 180.0;

Log set_poses(Log street, PoseTrack track);

PoseTrack perturb_track(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed);
PoseTrack add_drift(PoseTrack track, double amplitude_m, double amplitude_rad);

/// Errors of wheel odometry and gyroscopes: 1 % too much distance, 1 degree of heading
/// and 0.3 degrees of pitch per 100 m, jumps of 0.3 m at 1/5, 2/5, 3/5 and 4/5 of the
/// track.
PoseTrack add_drift_and_jumps(const PoseTrack& exact);

struct PoseError {
    double median_m, median_deg, rms_m, worst_m, worst_deg;
};
/// Errors after removing the common rigid motion.
PoseError error_of(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions);

/// Records a drive between shapes on flat ground. A sweep has 32 beams, a rolling
/// shutter, range noise of 1 cm, and no labels.
Log record_drive(const PoseTrack& track, std::vector<street::StreetShape> shapes, int columns);

/// Makes a drive of 283 m around a block in n_frames sweeps of 128 columns at 10 Hz:
/// straight roads, curves, a stop of 2 s, and an end slightly beyond the start.
Log drive_around_block(int n_frames);

}  // namespace relidar::test
