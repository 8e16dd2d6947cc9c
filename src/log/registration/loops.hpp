// SPDX-License-Identifier: Apache-2.0
// Loop closure: registers scans of a later pass of a road to the map of an earlier pass,
// and distributes the drift over the path between them.
#pragma once

#include <functional>
#include <vector>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct LoopOptions {
    RegisterRound first, last;  ///< cell size and kernel scale of a scan's steps, from coarse to fine
    std::function<bool(double done)> proceed;  ///< called regularly; if it returns false, the search ends
};

struct ClosedLoops {
    PoseTrack track;
    std::size_t places = 0;  ///< number of scans that were registered to the map of an earlier pass
    double largest_m = 0.0;  ///< largest drift of these scans
};

/// Finds pairs of poses that are close to each other although the path between them is at
/// least 80 m long. The distance limit grows with the length of the path. A pair counts
/// if the later scan's points lie on the planes of the earlier pass as well as in
/// odometry. Pairs that contradict the others get smaller weights (Geman and McClure
/// 1985). The corrections x of the poses then minimise
///   sum over the track of |x_k+1 - x_k|^2 / s_k^2  +  sum over pairs of rho(|x_later - x_earlier - drift|)
/// Each x is a translation and a rotation that also moves all later poses.
/// @param followed  track from odometry: accurate from scan to scan, with a drift of
/// metres over kilometres
/// @param scans  [poses] points of each scan; empty for poses without points
/// @return the input track if fewer than two pairs are found, or if proceed() returned
/// false
ClosedLoops close_loops(const PoseTrack& followed, const std::vector<std::vector<ThinPoint>>& scans,
                        const LoopOptions& options);

}  // namespace relidar
