// SPDX-License-Identifier: Apache-2.0
// Groups the points of a sweep into firings (all lasers at one azimuth). Used if points
// have firing times or are stored in firing order.
#pragma once

#include <map>
#include <vector>

#include <relidar/read/clouds.hpp>

namespace relidar {

/// Assigns each point to a firing (LidarPoints::firing). Sorts the firings by the mean
/// head azimuth of their points. Two firings with the same azimuth stay separate, because
/// a sweep may be longer than one revolution. The azimuths of firings without points are
/// interpolated. At the end of the turn, adds firings without points until the circle or
/// the image is full.
/// @param firing_numbers  [points] firing number of each point; the numbers increase with
/// time
/// @param azimuth_step_rad  azimuth step between firings at a constant rotation rate;
/// negative for a head that rotates clockwise
SweepFirings arrange_firings(LidarPoints& points, const std::vector<int>& firing_numbers,
                             const SpinningSensor& sensor, double azimuth_step_rad);

/// Assigns each point to its firing. Sorts the firings by decreasing azimuth of the head.
/// @param head_azimuth_by_firing  radians for each firing number, also without points
SweepFirings sort_firings(LidarPoints& points, const std::vector<int>& firing_numbers,
                          const std::map<int, double>& head_azimuth_by_firing);

}  // namespace relidar
