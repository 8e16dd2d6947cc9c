// SPDX-License-Identifier: Apache-2.0
// Groups the points of a sweep into firings. Used for datasets whose points have firing
// times, or whose points are stored in the order of the firings.
#pragma once

#include <map>
#include <vector>

#include <relidar/log/clouds.hpp>

namespace relidar {

/// Assigns each point to a firing (Points::firing). Sorts the firings by the mean head
/// azimuth of their points. A sweep may be longer than one revolution, so two firings
/// with the same azimuth stay separate.
///
/// Some firings have no points, for example where the vehicle blocks all beams. Their
/// deviation from a constant rotation is interpolated between the neighbouring firings.
/// At the end of the turn, adds firings without points until the circle, or the image of
/// `sensor.columns`, is full. All rays of a firing without points are dropped rays.
/// @param points  points with rings, at least one
/// @param numbers  [points] firing number of each point; the numbers increase with time
/// @param step_rad  azimuth step between firings at a constant rotation rate; negative
/// for a head that rotates clockwise
Sweep arrange_firings(Points& points, const std::vector<int>& numbers, const SpinningSensor& sensor,
                      double step_rad);

/// Sorts firings by the azimuth of the head, and assigns each point to its firing.
/// @param numbers  [points] firing number of each point
/// @param head_rad  azimuth of the head for each firing number, also for firings without
/// points
Sweep sort_firings(Points& points, const std::vector<int>& numbers, const std::map<int, double>& head_rad);

}  // namespace relidar
