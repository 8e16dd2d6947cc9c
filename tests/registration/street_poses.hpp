// SPDX-License-Identifier: Apache-2.0
// Wrong poses of the synthetic street, and how far poses are from the exact ones.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/sequence.hpp>

namespace relidar::test {

/// Every pose moved by white noise with these standard deviations in total.
PoseTrack perturbed(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed);
/// Every pose moved by a smooth curve of these amplitudes.
PoseTrack drifting(PoseTrack track, double amplitude_m, double amplitude_rad);

struct PoseError {
    double median_m, median_deg;
};
/// Median over some poses, after their common rigid motion is taken out (least squares, linear in the small rotation).
PoseError error_of(const PoseTrack& track, const PoseTrack& exact, const std::vector<int>& positions);

}  // namespace relidar::test
