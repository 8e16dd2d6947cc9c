// SPDX-License-Identifier: Apache-2.0
// Determines the firings of sweeps in datasets whose points have firing times or whose
// file order shows the firings.
#pragma once

#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Assigns a firing to each point (Points::firing). The firings are sorted by the mean
/// head azimuth of their points. A sweep may be longer than one revolution, so two
/// firings with the same azimuth stay separate. A firing without points, for example
/// where the vehicle blocks all beams, is interpolated between its neighbours. It
/// deviates from an even rotation as much as they do.
/// @param points  points with rings, at least one
/// @param numbers  [n] firing number of each point, in order of time
/// @param step_rad  azimuth step between firings at an even rotation; negative for a
/// clockwise head
Sweep arrange_firings(Points& points, const std::vector<int>& numbers, const SpinningSensor& sensor,
                      double step_rad);

}  // namespace relidar
