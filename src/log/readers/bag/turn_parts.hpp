// SPDX-License-Identifier: Apache-2.0
// Joins clouds to full revolutions. Some drivers publish halves or slices of a revolution
// as separate clouds.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Interval of azimuths that contains a set of points.
struct AzimuthArc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Computes the azimuth range of a cloud, in steps of 6 degrees, from about 256 of its
/// points. Returns nothing if the cloud has no field x or y.
std::optional<AzimuthArc> compute_azimuth_range(const CloudMessage& cloud);

/// A cloud that is a part of a revolution.
struct RevolutionPart {
    std::int64_t stamp_ns = 0, log_ns = 0;
    MessagePosition message_position;
    std::uint32_t n_points = 0;
    AzimuthArc arc;
};

struct JoinedRevolutions {
    /// One list for each full revolution: the partial clouds that form it, sorted by
    /// time. Empty if no clouds need to be joined.
    std::vector<std::vector<RevolutionPart>> revolutions;
    std::size_t n_left_out = 0;  ///< parts of incomplete revolutions
    std::string about;
};
/// Joins clouds that are parts of a revolution. Joins nothing if the clouds are full
/// revolutions, or if the LiDAR scans a window and does not rotate.
/// @param partial_clouds  all clouds of a topic
JoinedRevolutions join_partial_clouds_to_revolutions(std::vector<RevolutionPart> partial_clouds);

}  // namespace relidar::bag
