// SPDX-License-Identifier: Apache-2.0
// Joins clouds to full revolutions, because some drivers publish halves or slices of a
// revolution as separate clouds.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Azimuth range that a set of points covers about the z axis.
struct Arc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Computes the azimuth range of a cloud from about 256 points, with a resolution of 6
/// degrees. Returns nothing if the cloud has no field x or y.
std::optional<Arc> compute_arc(const Cloud& cloud);

/// A cloud that is a part of a revolution.
struct TurnPart {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
    std::uint32_t n_points = 0;
    Arc arc;
};

struct JoinedTurns {
    /// Clouds of each revolution, sorted by time stamp. Empty if no clouds were joined,
    /// because each cloud is a full revolution or the LiDAR scans a window.
    std::vector<std::vector<TurnPart>> turns;
    std::size_t n_left_out = 0;  ///< parts of incomplete revolutions
    std::string about;
};
/// Joins the clouds of a topic to full revolutions. Joins no clouds if each cloud is a
/// full revolution, or if the LiDAR scans a window and does not rotate.
/// @param clouds  all clouds of a topic
JoinedTurns join_turns(std::vector<TurnPart> clouds);

}  // namespace relidar::bag
