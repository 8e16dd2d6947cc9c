// SPDX-License-Identifier: Apache-2.0
// Poses found scan by scan, each on the map of the scans before it: where given poses drift or jump, or where there are none.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "registration/thin_scans.hpp"
#include "registration/voxel_planes.hpp"

namespace relidar {

struct OdometryOptions {
    RegisterRound first, last;                       ///< cells and kernels of a scan's steps, from coarse to fine
    bool given_motion = true;                        ///< the given poses say how the sensor moved from scan to scan; false: it keeps its velocity
    std::function<bool(double done)> proceed;        ///< called before each scan; false ends it
};

struct Odometry {
    PoseTrack track;                    ///< starts where the given poses start
    std::vector<std::size_t> lost;      ///< poses whose scan did not find its place: moved as predicted
    bool stopped = false;
};

/// @param scans  [poses] points of each scan; empty where a pose has none of its own: moved as predicted
Odometry follow_scans(const PoseTrack& given, const std::vector<std::vector<ThinPoint>>& scans, const OdometryOptions& options);

}  // namespace relidar
