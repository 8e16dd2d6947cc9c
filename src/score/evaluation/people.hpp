// SPDX-License-Identifier: Apache-2.0
// Metrics for people and cyclists. Separate metrics are needed because people have so few
// points that averages over a scan do not show their errors.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// Computes metrics of all moving people and cyclists with at least ten real points in
/// their boxes.
///   actors/people_cd_m   Chamfer distance: sum of both directions, mean over people
///   actors/people_3cm    fraction of the simulated points with a real point within 3 cm
///   actors/people_f1     F1 score of the rays that return from them (silhouettes)
/// @param points_m [n] ranges of the simulated points
/// @return empty if there are no such people or cyclists
MetricRow people_scores(const RangeImage& rendered, const std::vector<float>& points_m,
                        const RangeImage& real, const Sequence& sequence, const SweepMoment& seen);

}  // namespace relidar
