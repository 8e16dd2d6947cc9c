// SPDX-License-Identifier: Apache-2.0
// Metric for comet tails: wrong points at a position where a moving actor was earlier or
// will be later, but is not now.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// Returns the fraction of all returned points that lie in comet tails. The tail of a
/// moving box is the volume that the box occupies at other times of the log, but not now.
/// The current boxes are enlarged by 0.3 m. The lowest 0.3 m of the boxes counts as
/// ground. Each point is tested at the time at which the head faces it.
/// @return actors/tail_share of the rendered image and actors/tail_share_real; empty if
/// no box moves
MetricRow tail_shares(const RangeImage& rendered, const RangeImage& real, const Sequence& sequence,
                      const SweepMoment& seen);
/// Returns the number of returned points in the tail of each moving box. The tails of
/// several boxes can contain the same point.
/// @param points_m [n] ranges of the points of the image
/// @return the number of points for the id of each box
std::map<std::string, std::size_t> points_in_tails(const RangeImage& image,
                                                   const std::vector<float>& points_m,
                                                   const Sequence& sequence, const SweepMoment& seen);

}  // namespace relidar
