// SPDX-License-Identifier: Apache-2.0
// LiDAR odometry: registers each scan to the map of the scans before it. Used if the
// given poses drift, jump or are missing. A long log is divided into segments, which
// threads and processes register concurrently. Consecutive segments overlap by some
// scans. Each segment is aligned with its predecessor at the last common scan.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct OdometryOptions {
    RegisterRound first, last;  ///< cell size and kernel scale of a scan's steps, from coarse to fine
    /// True: the given poses predict the motion between scans. False: constant velocity.
    bool given_motion = true;
    /// Called regularly from the calling thread; if it returns false, odometry ends.
    std::function<bool(double done)> proceed;
    ProcessGroup group = {};
};

/// Registers all scans in order. A scan that cannot be registered keeps its predicted
/// pose.
/// @param scans  [poses] points of each scan; empty for poses without points
/// @return the same track in all processes. It starts at the first given pose. If
/// proceed() returned false, the given poses.
PoseTrack follow_scans(const PoseTrack& given, const std::vector<std::vector<ThinPoint>>& scans,
                       const OdometryOptions& options);

}  // namespace relidar
