// SPDX-License-Identifier: Apache-2.0
// Wrong poses of the synthetic street, and how far poses are from the exact ones.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar::test {

inline constexpr double kDegree = kPi / 180.0;

Sequence with_poses(Sequence street, PoseTrack track);

/// Every pose moved by white noise with these standard deviations in total.
PoseTrack perturbed(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed);
/// Every pose moved by a smooth curve of these amplitudes.
PoseTrack drifting(PoseTrack track, double amplitude_m, double amplitude_rad);

/// What is integrated from wheels and gyros: 1 % of the way too much, 1 degree of heading
/// and 0.3 degrees of pitch per 100 m, and jumps of 0.3 m at a fifth, at two, at three
/// and at four fifths of the track.
PoseTrack with_drift_and_jumps(const PoseTrack& exact);

struct PoseError {
    double median_m, median_deg, rms_m, worst_m, worst_deg;
};
/// Over some poses, after their common rigid motion is taken out.
PoseError error_of(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions);

}  // namespace relidar::test
