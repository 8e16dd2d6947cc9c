// SPDX-License-Identifier: Apache-2.0
// Comet tails: points where a moving actor has been or will be, but is not.
#pragma once

#include <relidar/log/range_image.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// Share of the returned points that lie in the volume which moving boxes sweep over the
/// log but do not occupy now (boxes as they are now grown by 0.3 m, the lowest 0.3 m of
/// the swept ones is ground), of all returned points. Each point is taken when the head
/// faces it.
/// @return actors/tail_share of the rendering and actors/tail_share_real; nothing where
/// no box moves
MetricRow tail_shares(const RangeImage& rendered, const RangeImage& real, const Sequence& sequence,
                      const SweepMoment& seen);

}  // namespace relidar
