// SPDX-License-Identifier: Apache-2.0
// Converts a sweep to the form that published results use for training: an image of cells
// of elevation and azimuth (train.grid) instead of the fired rays.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the frame with a ray for each cell. The ray goes from the sensor origin
/// through the centre of the cell. A cell uses its nearest return: its range is the range
/// of the point (Eq. 6-7); intensity, time and beam are those of the return's ray. A cell
/// without a return is a dropped ray, fired when the head faces the cell. Second returns
/// are removed.
Frame on_grid(const Sequence& sequence, const Frame& frame, const RangeGrid& grid);

}  // namespace relidar
