// SPDX-License-Identifier: Apache-2.0
// Converts a rendered scan to points in a frame.
// Files, recordings, the service, the viewer and Python all use this function. The GPU
// kernel of ScanRenderer::submit_points() computes bitwise equal points.
#pragma once

#include <optional>

#include <relidar/read/points.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

enum class PointSelection {
    first_returns,  ///< rays that return
    returns,        ///< First and second returns. A second return follows the first return of the same ray.
    rays            ///< All rays. If a ray hit nothing, its point is at the origin of the ray.
};

/// Converts the rays of a scan to points in a frame, in the order of the rays.
/// config.render.points selects the kind of range. The points have all properties except
/// `firing`. They have `return_number` only if second returns are requested and the scan
/// has second returns. Channels that hold directions are rotated with the points. The
/// computation uses single precision: positions are within 0.03 mm at 80 m.
/// @param dataset_from_points  frame of the points. If not set, each point is in the
/// sensor's frame at the firing time of its ray.
/// @throws DataError in the same cases as check_channels()
LidarPoints place_points(const RenderedScan& scan, const Config& config,
                         const std::optional<Pose>& dataset_from_points,
                         PointSelection selection = PointSelection::returns);

}  // namespace relidar
