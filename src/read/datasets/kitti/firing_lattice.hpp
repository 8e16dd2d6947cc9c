// SPDX-License-Identifier: Apache-2.0
// Estimates the firing times and head angles of an HDL-64E. All 64 beams fire together,
// about 2152 times per revolution. An encoder with ticks of 0.09 degrees measures the
// head angle of each firing. So the azimuth of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same tick size for all beams. The offsets offset_k and left_k of each beam are
// fitted to the log. They give the firings of each sweep. If a beam has no point at a
// firing, the ray is a dropped ray (without a return).
#pragma once

#include <array>
#include <vector>

#include <relidar/read/clouds.hpp>

#include "read/datasets/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// ticks of an HDL-64E's encoder per revolution, measured on KITTI 2011_09_26_drive_0005
inline constexpr int kEncoderTicks = 4000;

/// Azimuths at which the head can fire, and for each beam its azimuth relative to the
/// head and its distance from the spin axis.
struct FiringGrid {
    EncoderTickGrid head;
    /// True if the points fit no encoder ticks. `head` then has estimated equal steps,
    /// and the LiDAR fires at every tick.
    bool every_tick = false;
    /// relative to the head; the mean is 0
    std::array<double, kRings> offset_rad{};
    /// from the spin axis, positive to the left
    std::array<double, kRings> left_m{};

    /// Returns the beams of the sensor. Combines the offsets of this grid with the
    /// elevations and heights of `cones`.
    std::vector<Beam> make_beams(const BeamCones& cones) const;
};

/// Estimates the azimuth grid at which the head fires, and the offsets of all beams, from
/// a few scans. If the azimuths fit no grid, returns equal steps and zero offsets.
FiringGrid fit_firing_grid(const std::vector<const RingScan*>& scans);

/// Returns the ticks at which the head fired, in order of time: clockwise from +pi.
std::vector<int> find_fired_ticks(const RingScan& scan, const FiringGrid& grid);

}  // namespace relidar::kitti
