// SPDX-License-Identifier: Apache-2.0
// Converts a sweep to the form that published methods use for training. The result is an
// image of elevation and azimuth cells (train.grid) instead of the fired rays.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the frame with one ray for each cell of the grid. The ray goes from the sensor
/// origin through the centre of the cell. The range of a cell is the range of its nearest
/// return (Eq. 6-7). The cell also takes the intensity, time and beam of this return. A
/// cell without a return is a dropped ray. Its time is when the LiDAR's head faces the
/// cell. Second returns are removed.
Frame on_grid(const Sequence& sequence, const Frame& frame, const RangeGrid& grid);

}  // namespace relidar
