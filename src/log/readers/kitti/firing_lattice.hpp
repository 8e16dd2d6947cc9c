// SPDX-License-Identifier: Apache-2.0
// Estimates the firing times and head angles of an HDL-64E. All 64 beams fire together,
// about 2152 times per revolution. An encoder with ticks of 0.09 degrees measures the
// head angle of each firing. So the azimuth of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same tick size for all beams. The azimuth offset and the left offset of each
// beam are fitted to the log. With these offsets, the firings of each sweep can be
// computed. If a beam has no point at a firing, the ray is a dropped ray (without a
// return).
#pragma once

#include <array>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// Grid of the possible head angles, and azimuth and left offset of each beam.
struct FiringLattice {
    HeadLattice head;
    /// If true, the sensor is assumed to fire at every step of the grid. This is assumed
    /// if the azimuths show no ticks of a rotary encoder.
    bool every_tick = false;
    /// azimuth of each beam relative to the head; the mean of all beams is 0
    std::array<double, kRings> offset_rad{};
    /// Distance of each beam from the spin axis. It is positive if the beam is left of
    /// the axis.
    std::array<double, kRings> left_m{};

    /// Returns the beams of the sensor. The elevations are from the fitted cones. The
    /// azimuth and left offsets are from this fit. The origin of a beam is z0
    /// cos(elevation) above the origin of the sensor.
    std::vector<Beam> beams(const Cones& cones) const;
};

/// Fits the head angles and the beam offsets to a few scans. If the azimuths are not
/// multiples of a tick, as in a resampled log, returns even steps and zero offsets.
FiringLattice fit_lattice(const std::vector<const RawScan*>& scans);

/// Returns the encoder ticks at which the sensor fired in a sweep, sorted by time. The
/// head rotates clockwise, so the azimuths decrease from +pi.
std::vector<int> find_firings(const RawScan& scan, const FiringLattice& lattice);

}  // namespace relidar::kitti
