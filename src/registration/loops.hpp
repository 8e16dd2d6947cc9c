// SPDX-License-Identifier: Apache-2.0
// Closes loops. Registers scans of a later pass over a road to the map of the earlier
// pass. Then distributes the position error over the path between the two passes.
#pragma once

#include <functional>

#include "registration/thin_scans.hpp"

namespace relidar {

struct LoopClosureResult {
    PoseTrack track;
    std::size_t n_closures = 0;  ///< number of loop closures
    double largest_m = 0.0;      ///< largest correction of a loop closure, in metres
};

/// Closes the loops of a track. Searches for poses near a position that the track passed
/// at least 80 m of path earlier. The allowed distance grows with the path length. A loop
/// closure is accepted if enough points of the scan lie on planes of the earlier pass. A
/// loop closure that contradicts other ones gets a lower weight (Geman and McClure 1985).
/// The corrections x of the poses minimise
///   sum over the track of |x_k+1 - x_k|^2 / s_k^2
///   + sum over loop closures of rho(|x_later - x_earlier - measured correction|)
/// where each x is a translation and a rotation that also moves all later poses.
/// @param odometry_track  poses from odometry: accurate from scan to scan, with a drift
/// of metres over kilometres
/// @param first, last  coarsest and finest plane map (PlaneMaps)
/// @param proceed  reports the progress, 0 to 1; loop closing stops if it returns false
/// @return the unchanged track if fewer than two closures exist or loop closing stopped
LoopClosureResult close_loops(const PoseTrack& odometry_track, const SubsampledScans& scans,
                              const FitRound& first, const FitRound& last,
                              const std::function<bool(double done)>& proceed);

}  // namespace relidar
