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

/// Azimuth range of some points about the z axis.
struct Arc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Computes the azimuth range of a cloud from about 256 of its points. The resolution is
/// 6 degrees. Returns nothing if the cloud has no x or y.
std::optional<Arc> arc_of(const Cloud& cloud);

/// A cloud that is a part of a revolution.
struct TurnPart {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Place place;
    std::uint32_t n_points = 0;
    Arc arc;
};

struct JoinedTurns {
    /// The parts of each revolution in the order of their stamps. Empty if nothing is
    /// joined: each cloud is a full revolution, or covers a window.
    std::vector<std::vector<TurnPart>> turns;
    std::size_t n_left_out = 0;  ///< parts of incomplete revolutions
    std::string about;
};
/// Joins the clouds of a topic to revolutions. Nothing is joined if each cloud is a full
/// revolution, or if the LiDAR scans a window and does not spin.
/// @param clouds  all clouds of a topic
JoinedTurns join_turns(std::vector<TurnPart> clouds);

}  // namespace relidar::bag
