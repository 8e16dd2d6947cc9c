// SPDX-License-Identifier: Apache-2.0
// Counts points in comet tails. These are wrong points at positions that a moving actor
// occupies at another time of the log.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct CometTailStatistics {
    double share = 0.0;  ///< Fraction of all returned points that are in a tail.
    /// By box id. Tails of several boxes can contain the same point.
    std::map<std::string, std::size_t> n_of_box;
};
/// Counts returned points at positions that a moving box occupies only at other times of
/// the log. Boxes at the time of the point are enlarged by 0.3 m. Points in the lowest
/// 0.3 m of a box belong to the ground. The time of a point is when the LiDAR's head
/// faces it.
/// @param point_ranges_m [n] ranges of the points of the image
CometTailStatistics count_tail_points(const RangeImage& image, const std::vector<float>& point_ranges_m,
                                      const Log& sequence, const SweepTiming& sweep);

}  // namespace relidar
