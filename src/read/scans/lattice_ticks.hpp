// SPDX-License-Identifier: Apache-2.0
// Measures the rotation of the sensor about z in a sweep. The elevations do not show it,
// but the head fires at multiples of a tick.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "read/scans/lattice_fit.hpp"

namespace relidar::read {

/// A rotation rate about z that was measured with the azimuths of points.
struct YawFit {
    std::array<double, 2> turned_rad{};  ///< in a turn, before and after the time of the frame
    double coherence = 0.0;              ///< 1 if all azimuths are multiples of the tick
};

/// minimum coherence with which azimuths show the rotation
inline constexpr double kMinCoherence = 0.1;
/// number of sweeps that show the distances of the beams from the axis
inline constexpr std::size_t kOffsetSweeps = 3;

/// Returns [rings] the distances in metres by which beams start to the left of the axis.
/// Collects the points of each ring in bins of the azimuth. In a bin, the right distance
/// turns the azimuths at all ranges into multiples of the angle of a tick.
std::vector<double> fit_left_offsets(const std::vector<LidarPoints>& sweeps, std::size_t n_rings,
                                     int n_ticks);

/// Measures the rotation about z that the compensation added to the azimuths. The phases
/// (ticks.n * azimuth) of bins of the turn then differ in proportion to their distance.
YawFit fit_yaw(const std::vector<FiredPoint>& points, const std::vector<std::uint16_t>& rings,
               const HeadTurn& turn, const HeadTicks& ticks);

}  // namespace relidar::read
