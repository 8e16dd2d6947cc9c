// SPDX-License-Identifier: Apache-2.0
// Estimates poses by odometry: aligns each scan with a map of the earlier scans. Needed
// if the given poses drift or jump, or if there are no poses. A long log is divided into
// overlapping sections, which threads and processes handle in parallel. Two sections are
// connected at the last scan that they share.
#pragma once

#include <functional>

#include <relidar/base/process_group.hpp>

#include "registration/thin_scans.hpp"

namespace relidar {

struct OdometryOptions {
    FitRound first, last;  ///< coarsest and finest plane map (PlaneMaps)
    /// true: the given poses predict the motion between scans; false: the velocity
    bool use_pose_motion = true;
    /// Callback with the progress, called repeatedly from the calling thread. If it
    /// returns false, the estimation stops.
    std::function<bool(double done)> proceed;
    ProcessGroup group = {};
};

/// Estimates the poses of a log, starting at the first pose of `initial_track`. A scan
/// that cannot be aligned gets its predicted pose.
/// @return estimated poses, identical in all processes of `options.group`;
/// `initial_track` if the callback `options.proceed` returned false
PoseTrack run_odometry(const PoseTrack& initial_track, const SubsampledScans& scans,
                       const OdometryOptions& options);

}  // namespace relidar
