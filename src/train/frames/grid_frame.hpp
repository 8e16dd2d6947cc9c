// SPDX-License-Identifier: Apache-2.0
// A sweep as published results train on it: an image of cells of elevation and azimuth
// (train.grid), instead of the rays that were fired.
#pragma once

#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// The frame with one ray a cell, through its centre, from the sensor's origin. The
/// nearest return in a cell is the cell's: its range is that of the point (Eq. 6-7),
/// intensity, time and beam are those of its ray. A cell without one is a dropped ray,
/// fired when the head faced it. Further returns are left out.
Frame on_grid(const Sequence& sequence, const Frame& frame, const RangeGrid& grid);

}  // namespace relidar
