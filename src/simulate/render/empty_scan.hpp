// SPDX-License-Identifier: Apache-2.0
// Creates a scan without measurements. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Returns a scan with these rays but without measurements. Its channels have no values
/// yet.
/// @param taken another scan of the same sweep, from which times, poses and channel names
/// are copied; optional
inline RenderedScan empty_scan(const RayTable& rays, const RenderedScan& taken = {}) {
    RenderedScan scan;
    scan.image.rows = rays.rows;
    scan.image.columns = rays.columns;
    scan.image.origin = to_vector(rays.origin);
    scan.image.direction = to_vector(rays.direction);
    scan.time_offset_s = to_vector(rays.time_offset_s);
    scan.ring = to_vector(rays.channel);
    scan.world_from_sensor = taken.world_from_sensor;
    scan.track = taken.track;
    scan.time_s = taken.time_s;
    scan.trace_ms = taken.trace_ms;
    scan.unseen_share = taken.unseen_share;
    scan.channels = remove_values(taken.channels);
    return scan;
}

}  // namespace relidar
