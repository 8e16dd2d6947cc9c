// SPDX-License-Identifier: Apache-2.0
// Poses found scan by scan, each on the map of the scans before it: where given poses
// drift or jump, or where there are none. A long log is followed in stretches, which
// threads and processes do at the same time; a stretch begins some scans before the one
// before it ends, and is put where that one has seen the last of these.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct OdometryOptions {
    RegisterRound first, last;  ///< cells and kernels of a scan's steps, from coarse to fine
    /// the given poses say how the sensor moved from scan to scan; false: it keeps its
    /// velocity
    bool given_motion = true;
    /// called now and then, from the calling thread; false ends it
    std::function<bool(double done)> proceed;
    ProcessGroup group = {};
};

/// Scans that do not find their place move as predicted. @param scans  [poses] points of
/// each scan; empty where a pose has none of its own
/// @return the same in all processes; starts where the given poses start; the given poses
/// where proceed() ended it
PoseTrack follow_scans(const PoseTrack& given, const std::vector<std::vector<ThinPoint>>& scans,
                       const OdometryOptions& options);

}  // namespace relidar
