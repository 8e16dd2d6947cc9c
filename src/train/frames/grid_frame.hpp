// SPDX-License-Identifier: Apache-2.0
// Converts a sweep to an image with elevation and azimuth cells (train.grid), which
// published methods use for training. The image replaces the fired rays.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Returns the frame with one ray for each cell of the grid. The ray starts at the sensor
/// origin and passes through the centre of the cell. A cell gets the range, intensity,
/// time and beam of its nearest return (Eq. 6-7). A cell without a return becomes a
/// dropped ray. Its time is the time at which the LiDAR's head faces the cell. Second
/// returns are removed.
LidarFrame convert_frame_to_grid(const LidarSequence& sequence, const LidarFrame& frame,
                                 const RangeImageGrid& grid);

}  // namespace relidar
