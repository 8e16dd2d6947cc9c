// SPDX-License-Identifier: Apache-2.0
// Scores of people and cyclists alone: few points, which no mean over a scan shows.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// Of all people and cyclists that move and really returned at least ten points, by
/// people_points():
///   actors/people_cd_m   distance to the nearest point of the other, both ways summed, mean over them
///   actors/people_3cm    share of the simulated points that have a real one within 3 cm
///   actors/people_f1     F1 of the rays that return from them, as silhouettes
/// @param points_m [n] ranges of the simulated points @return nothing where there is
/// nobody
MetricRow people_scores(const RangeImage& rendered, const std::vector<float>& points_m,
                        const RangeImage& real, const Sequence& sequence, const SweepMoment& seen);

}  // namespace relidar
