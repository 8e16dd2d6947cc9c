// SPDX-License-Identifier: Apache-2.0
// A scan as points in a frame. Files, recordings, the service, the viewer and Python use
// this one function. The device kernel of ScanRenderer::ask_points() computes the same
// bits.
#pragma once

#include <optional>

#include <relidar/log/points.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Which rays and returns of a scan become points.
enum class PointsOf {
    first_returns,  ///< rays that return
    returns,        ///< second returns too, each behind the first return of its ray
    rays            ///< all rays; a ray that met nothing has its point at its origin
};

/// Places the ends of the rays of a scan in a frame. Points are in the order of their
/// rays, at the ranges that config.render.points selects. They have all properties except
/// `firing`; `return_number` is known if second returns are requested and the scan has
/// them. Directions among the channels turn with the points. The arithmetic is single
/// precision: positions are within 0.03 mm at 80 m.
/// @param dataset_from_points  frame of the points; none: each point is in the sensor's
/// frame at the firing time of its ray
/// @throws DataError as check_channels()
Points place_points(const RenderedScan& scan, const Config& config,
                    const std::optional<Pose>& dataset_from_points, PointsOf of = PointsOf::returns);

}  // namespace relidar
