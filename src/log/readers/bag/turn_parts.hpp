// SPDX-License-Identifier: Apache-2.0
// Clouds that are halves or slices of a turn, as some drivers publish them, put together
// into whole turns.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Azimuths within which points lie, from z up.
struct Arc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Of some 256 of a cloud's points, to 6 degrees; nothing where they have no numbers for
/// x and y.
std::optional<Arc> arc_of(const Cloud& cloud);

/// One of the clouds of a turn.
struct TurnPart {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
    std::uint32_t n_points = 0;
    Arc arc;
};

struct JoinedTurns {
    /// of parts in the order of their stamps; none: each cloud is whole, or shows a
    /// window
    std::vector<std::vector<TurnPart>> turns;
    std::size_t n_left_out = 0;  ///< parts of turns that are not whole
    std::string about;
};
/// @param clouds  all of a topic. Whole turns and windows of LiDARs without a head come
/// as they are: nothing is joined
JoinedTurns join_turns(std::vector<TurnPart> clouds);

}  // namespace relidar::bag
