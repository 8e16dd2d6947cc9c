// SPDX-License-Identifier: Apache-2.0
// Creates a scan without measurements. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

/// @param where scan of the same sweep with times, poses and channel names
inline RenderedScan empty_scan(const RayTable& rays, const RenderedScan& where = {}) {
    RenderedScan scan;
    scan.image.rows = rays.rows;
    scan.image.columns = rays.columns;
    scan.image.origin = to_vector(rays.origin);
    scan.image.direction = to_vector(rays.direction);
    scan.time_offset_s = to_vector(rays.time_offset_s);
    scan.ring = to_vector(rays.channel);
    scan.world_from_sensor = where.world_from_sensor;
    scan.track = where.track;
    scan.time_s = where.time_s;
    scan.trace_ms = where.trace_ms;
    scan.unseen_share = where.unseen_share;
    scan.channels = copy_layout(where.channels);
    return scan;
}

}  // namespace relidar
