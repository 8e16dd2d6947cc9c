// SPDX-License-Identifier: Apache-2.0
// Estimates when and where an HDL-64E fired. All 64 beams fire together, about 2152 times
// per revolution. An encoder with ticks of 0.09 degrees measures the head angle of each
// firing. So the azimuth of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same tick size for all beams. The azimuth offset and the left offset of each
// beam are fitted to the log with this equation. The fit then gives the firings of each
// sweep. A beam without a point at a firing is a dropped return.
#pragma once

#include <array>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// Grid of the possible head angles, and the offsets of every beam.
struct FiringLattice {
    HeadLattice head;
    /// true: the head fires at every tick, because the azimuths show no encoder ticks
    bool every_tick = false;
    std::array<double, kRings> offset_rad{};  ///< azimuth of each beam relative to the head, mean 0
    /// distance between the spin axis and the beam, positive if the beam is left of the
    /// axis
    std::array<double, kRings> left_m{};

    /// Returns the beams: elevation from the cones, azimuth offset and left offset from
    /// this fit. The origin is z0 cos(elevation) above the sensor's origin.
    std::vector<Beam> beams(const Cones& cones) const;
};

/// Fits the head angles and the beam offsets to a few scans. If the azimuths are not
/// multiples of a tick (a resampled log), returns even steps and zero offsets.
FiringLattice fit_lattice(const std::vector<const RawScan*>& scans);

/// Returns the encoder ticks at which the head fired in a sweep. The ticks are in order
/// of time: the head rotates clockwise, so the azimuth decreases from +pi.
std::vector<int> find_firings(const RawScan& scan, const FiringLattice& lattice);

}  // namespace relidar::kitti
