// SPDX-License-Identifier: Apache-2.0
// Firing times of an HDL-64E. All 64 beams fire together, about 2152 times per sweep. The
// head angle of a firing is read from an encoder with ticks of 0.09 degrees. So the
// azimuth of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same ticks for all beams of a sweep. From this relation, the log determines
// the azimuth offset and left offset of each beam, and the firings of each sweep. A
// firing without a point is a dropped return.
#pragma once

#include <array>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// The lattice of head angles, and the offsets of every beam.
struct FiringLattice {
    HeadLattice head;
    bool every_tick = false;                  ///< true: fires at every tick (no encoder ticks were detected)
    std::array<double, kRings> offset_rad{};  ///< azimuth of each beam relative to the head, mean 0
    /// distance at which each beam passes to the left of the spin axis
    std::array<double, kRings> left_m{};

    /// Returns beams from the cones and the lattice: elevation, azimuth offset, origin up
    /// = z0 cos(elevation), origin left.
    std::vector<Beam> beams(const Cones& cones) const;
};

/// Estimates the lattice from a few scans. If the azimuths do not lie on a lattice (a
/// resampled log), uses even steps and zero offsets.
FiringLattice fit_lattice(const std::vector<const RawScan*>& scans);

/// Returns the ticks at which the head fired in a sweep, in order of time (clockwise,
/// azimuth falling from +pi).
std::vector<int> find_firings(const RawScan& scan, const FiringLattice& lattice);

}  // namespace relidar::kitti
