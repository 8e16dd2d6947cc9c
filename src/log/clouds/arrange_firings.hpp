// SPDX-License-Identifier: Apache-2.0
// Sweeps of datasets that tell which firing took each point, by its time or by the order
// of the file.
#pragma once

#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Names the firing of each point (Points::firing), firings arranged by azimuth of
/// the head, the mean of their points'. A sweep may be more than a turn: two firings of
/// one azimuth stay two. A firing without a point, as where the vehicle hides the world
/// from all beams, is looked for between its neighbours, as far from an even turn as they
/// are.
/// @param points  with rings, at least one
/// @param numbers  [n] of firings in order of time
/// @param step_rad  of an even turn, from one firing to the next; negative for a
/// clockwise head
Sweep arrange_firings(Points& points, const std::vector<int>& numbers, const SpinningSensor& sensor,
                      double step_rad);

}  // namespace relidar
