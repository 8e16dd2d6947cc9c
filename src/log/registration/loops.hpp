// SPDX-License-Identifier: Apache-2.0
// Roads that are driven again: scans of the later pass find their place on the map of the
// earlier one, and what they are off is spread over the way between.
#pragma once

#include <functional>
#include <vector>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct LoopOptions {
    RegisterRound first, last;                 ///< cells and kernel of a scan's steps, from coarse to fine
    std::function<bool(double done)> proceed;  ///< called now and then; false ends it
};

struct ClosedLoops {
    PoseTrack track;
    std::size_t places = 0;  ///< at which a scan found its place on the map of an earlier pass
    double largest_m = 0.0;  ///< by which one of them was off
};

/// Looks for poses that come near where the track was 80 m of its way before or earlier;
/// how near they must come grows with the way. A place counts where a scan's points lie
/// on the planes of the earlier pass as those of odometry do; of places that contradict
/// the others the weight falls off (Geman and McClure 1985). Corrections x of the poses
/// then minimise
///   sum over the track of |x_k+1 - x_k|^2 / s_k^2  +  sum over places of rho(|x_later - x_earlier - what it was off|)
/// each x a translation and a rotation that carries along what comes after it.
/// @param followed  by odometry: right from scan to scan, drifting by metres over
/// kilometres
/// @param scans [poses] points of each scan; empty where a pose has none of its own
/// @return the track as it was where fewer than two places are found, or proceed() ended
/// it
ClosedLoops close_loops(const PoseTrack& followed, const std::vector<std::vector<ThinPoint>>& scans,
                        const LoopOptions& options);

}  // namespace relidar
