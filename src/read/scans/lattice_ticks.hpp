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
/// With the right distance, neighbouring points at different ranges have equal phases.
std::vector<double> fit_left_offsets(const std::vector<LidarPoints>& sweeps, std::size_t n_rings,
                                     int n_ticks);

/// Measures the rotation about z that the compensation added to the azimuths. The phases
/// of the ticks then drift in the turn. Compares the phases of bins that are more and
/// more distant.
YawFit fit_yaw(const std::vector<FiredPoint>& points, const std::vector<std::uint16_t>& rings,
               const HeadTurn& turn, const HeadTicks& ticks);

}  // namespace relidar::read
