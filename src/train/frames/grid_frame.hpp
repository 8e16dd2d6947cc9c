// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Replaces the fired rays by one ray from the sensor origin through the centre of each
/// cell of the grid (train.grid). A cell gets the range, intensity, time and beam of its
/// nearest return (Eq. 6-7). A cell without a return becomes a dropped ray at the time at
/// which the LiDAR's head faces it. Second returns are removed.
Frame frame_to_grid(const Log& sequence, const Frame& frame, const RangeImageGrid& grid);

}  // namespace relidar
