// SPDX-License-Identifier: Apache-2.0
// When an HDL-64E fired. All 64 beams fire together, about 2152 times a sweep, and the
// head angle of a firing is read from an encoder with 0.09 degree ticks. So the azimuth
// of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same set of ticks for all beams of a sweep. From that the log tells each
// beam's azimuth offset and left offset, and the firings of a sweep: a firing without a
// point is a dropped return.
#pragma once

#include <array>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// The lattice of head angles and every beam's place in it.
struct FiringLattice {
    HeadLattice head;
    bool every_tick = false;                  ///< fires at every tick (no encoder ticks were found)
    std::array<double, kRings> offset_rad{};  ///< azimuth of the beam relative to the head, mean 0
    std::array<double, kRings> left_m{};      ///< the beam passes the spin axis this far to its left

    /// Beams of the cones and the lattice: elevation, azimuth offset, origin up = z0
    /// cos(elevation), origin left.
    std::vector<Beam> beams(const Cones& cones) const;
};

/// Finds the lattice in a few scans. Where azimuths follow none (a resampled log), the
/// steps are even and offsets 0.
FiringLattice fit_lattice(const std::vector<const RawScan*>& scans);

/// Ticks at which the head fired in this sweep, in order of time (clockwise, azimuth
/// falling from +pi).
std::vector<int> find_firings(const RawScan& scan, const FiringLattice& lattice);

}  // namespace relidar::kitti
