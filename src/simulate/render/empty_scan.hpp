// SPDX-License-Identifier: Apache-2.0
// How every simulated scan begins. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

/// A scan of these rays without anything that came back. @param taken  a scan of the same
/// sweep: when, from where, in what time; none: not known yet. Of its channels there are
/// no values yet.
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
    scan.channels = emptied(taken.channels);
    return scan;
}

}  // namespace relidar
