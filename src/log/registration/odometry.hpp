// SPDX-License-Identifier: Apache-2.0
// Estimates poses scan by scan. Each scan is aligned with a map of the earlier scans.
// Odometry is needed if the given poses drift or jump, or if there are no poses. A long
// log is divided into overlapping sections, which threads and processes handle in
// parallel. Two sections are connected at the last scan that they share.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "log/registration/thin_scans.hpp"

namespace relidar {

struct OdometryOptions {
    /// cell sizes and robust-kernel scales for aligning a scan, from coarse to fine
    RegisterRound first, last;
    /// True if the given poses predict the motion from scan to scan. If false, the
    /// velocity is assumed to be constant.
    bool use_pose_motion = true;
    /// Progress callback, called repeatedly from the calling thread. If it returns false,
    /// the estimation stops.
    std::function<bool(double done)> proceed;
    ProcessGroup group = {};
};

/// Estimates the poses of a log. If a scan cannot be aligned, its predicted pose is used.
/// @param scans [poses] points of each scan; empty if a pose has no scan
/// @return poses that are identical in all processes and start at the first given pose;
/// the given poses if proceed() returned false
PoseTrack estimate_poses(const PoseTrack& initial_track, const std::vector<std::vector<ThinPoint>>& scans,
                         const OdometryOptions& options);

}  // namespace relidar
