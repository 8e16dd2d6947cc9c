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

/// Counts of the points of a scan that are in comet tails. A comet tail (motion trail) is
/// the space that a moving box occupies at other times of the log.
struct CometTailStatistics {
    double share = 0.0;  ///< Fraction of all returned points that are in a tail.
    /// Number of points in the tail (motion trail) of each moving box, by box id. Tails
    /// of several boxes can contain the same point.
    std::map<std::string, std::size_t> n_of_box;
};
/// Counts the returned points that lie in comet tails. The tail of a moving box is the
/// volume that the box occupies at other times of the log. Volume that any box occupies
/// at the time of the point is not part of a tail. For this test, boxes are enlarged by
/// 0.3 m. Points in the lowest 0.3 m of a box belong to the ground, not to a tail. The
/// time of a point is the time at which the LiDAR's head faces the point.
/// @param point_ranges_m [n] ranges of the points of the image
CometTailStatistics count_comet_tail_points(const RangeImage& image, const std::vector<float>& point_ranges_m,
                                            const LidarSequence& sequence, const SweepTiming& sweep);

}  // namespace relidar
