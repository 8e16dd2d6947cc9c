// SPDX-License-Identifier: Apache-2.0
// Joins clouds that are halves or slices of a revolution, as some drivers publish them,
// to complete revolutions.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Range of azimuths of some points, about the z axis.
struct Arc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Determines the azimuth range of a cloud from about 256 points, with 6 degrees
/// resolution. Returns nothing if x or y are missing.
std::optional<Arc> arc_of(const Cloud& cloud);

/// One of the clouds of a revolution.
struct TurnPart {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
    std::uint32_t n_points = 0;
    Arc arc;
};

struct JoinedTurns {
    /// Parts of each revolution in the order of their stamps. Empty: each cloud is
    /// complete, or covers a window.
    std::vector<std::vector<TurnPart>> turns;
    std::size_t n_left_out = 0;  ///< parts of incomplete revolutions
    std::string about;
};
/// Joins the clouds of a topic. Joins nothing if the clouds are complete revolutions, or
/// windows of LiDARs that do not spin.
/// @param clouds  all clouds of a topic
JoinedTurns join_turns(std::vector<TurnPart> clouds);

}  // namespace relidar::bag
