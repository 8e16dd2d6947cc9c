// SPDX-License-Identifier: Apache-2.0
// From the points of a KITTI turn to a Scan with a cell for every ray fired, those without a return included.
#pragma once

#include <vector>

#include <relidar/sequence.hpp>

#include "dataset/firing_lattice.hpp"
#include "dataset/hdl64_rings.hpp"

namespace relidar::kitti {

/// The sensor as recovered from a log.
struct Hdl64 {
    FiringLattice lattice;
    SpinningSensor sensor;  ///< beams highest first; columns = most firings in one turn
};

/// Beams of the cones and the lattice: elevation, azimuth offset, origin up = z0 cos(elevation), origin left.
std::vector<Beam> make_beams(const Cones& cones, const FiringLattice& lattice);

/// A turn in image order and what became of its points.
struct GriddedScan {
    Scan scan;
    std::size_t n_points = 0;
    std::size_t n_beyond = 0;  ///< farther than max_range_m: kept as dropped rays
    std::size_t n_lost = 0;    ///< two points for one ray, no free cell beside it: the nearer was kept
};

/// Puts every point on the ray that took it. A return keeps its own direction, its ray starts at the beam's origin; a firing
/// without a return becomes a dropped ray of the model. A turn with fewer firings than `columns` repeats some of its
/// firings, returns included, rather than invent drops: first where packets are missing, then at its end.
/// @param firings ticks of this turn in order of time
GriddedScan make_scan(const RawScan& raw, const std::vector<int>& firings, const Hdl64& hdl64, double max_range_m);

}  // namespace relidar::kitti
