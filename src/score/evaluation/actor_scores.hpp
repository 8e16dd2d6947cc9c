// SPDX-License-Identifier: Apache-2.0
// Metrics for moving boxes. They are needed because actors have few points, so that
// averages over a full scan hide their errors.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

struct FrameActorScores {
    std::vector<ActorScore> actors;  ///< scores of the labelled and the discovered boxes
    /// Metrics over all points, and over the labelled boxes with at least ten real
    /// points.
    ///   actors/{tail_share,tail_share_real}  fraction of the simulated and of the real
    ///                              points in comet tails
    ///   actors/people_*            people and cyclists
    ///   actors/vehicles_*          all other labelled boxes
    ///   actors/*_{medae_m,bias_m,above_30cm}  as in ActorScore, over all points
    ///   actors/*_cd_m              Chamfer distance: sum of both directions, mean over
    ///                              boxes
    ///   actors/*_3cm               fraction of the simulated points with a real point
    ///                              within 3 cm
    ///   actors/*_f1                F1 score of the rays that return from the boxes
    MetricValues metrics;
};

/// Compares the simulated with the real points in each moving box of a frame.
/// @param rendered,real images of the same rays
/// @param point_ranges_m [n] range of the simulated point on each ray
FrameActorScores score_actors(const RangeImage& rendered, const std::vector<float>& point_ranges_m,
                              const RangeImage& real, const Log& log, const SweepTiming& sweep);

/// Joins the scores of each actor in several frames: adds the numbers of points, and
/// averages other metrics, weighted by the real points. The actors with the most large
/// errors come first.
/// @param scores_per_frame [frames][actors]
std::vector<ActorScore> average_scores(const std::vector<std::vector<ActorScore>>& scores_per_frame);

/// Returns the median of |points / real points - 1| over the labelled vehicles with at
/// least ten real points in all frames together. Nothing if there is no such vehicle.
std::optional<double> median_points_error(const std::vector<ActorScore>& actors);

}  // namespace relidar
