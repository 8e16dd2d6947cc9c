// SPDX-License-Identifier: Apache-2.0
// Estimates poses scan by scan, each against a map of the earlier scans. It is used if
// the given poses drift or jump, or if there are none. A long log is divided into
// overlapping sections that threads and processes handle in parallel. The last scan that
// two sections share connects them.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct OdometryOptions {
    RegisterRound first, last;  ///< cells and kernels of a scan's alignment steps, from coarse to fine
    /// True if the given poses predict the motion from scan to scan. Otherwise the
    /// velocity is assumed to be constant.
    bool given_motion = true;
    /// Called repeatedly from the calling thread. If it returns false, the estimation
    /// stops.
    std::function<bool(double done)> proceed;
    ProcessGroup group = {};
};

/// Estimates the poses of a log. A scan that cannot be aligned gets its predicted pose.
/// @param scans [poses] points of each scan; empty if a pose has no scan
/// @return poses that are identical in all processes and start at the first given pose;
/// the given poses if proceed() returned false
PoseTrack follow_scans(const PoseTrack& given, const std::vector<std::vector<ThinPoint>>& scans,
                       const OdometryOptions& options);

}  // namespace relidar
