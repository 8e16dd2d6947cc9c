// SPDX-License-Identifier: Apache-2.0
// Where rays and their ends lie in the frame that the sensor's poses are given in. The
// sensor moves along a straight line and turns about one axis, at even speed, between two
// poses and beyond the first and last one. Host and device compute the same bits:
// src/CMakeLists.txt forbids fused multiplications and additions for place_points.cpp.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#include "../../base/shared/rotation.h"
#include "render.h"

RELIDAR_SHARED_BEGIN

/// End of a ray in the sensor's frame at its firing time.
RELIDAR_FUNCTION vec3 ray_end(vec3 origin, vec3 direction, float range_m) {
    RELIDAR_EXACT vec3 end = origin + range_m * direction;
    return end;
}

/// Share of the way to the next pose at a firing time.
RELIDAR_FUNCTION float way_share(SensorPose pose, float time_offset_s) {
    RELIDAR_EXACT float share = (time_offset_s - pose.time_offset_s) * pose.per_s;
    return share;
}

/// Turns a direction of the sensor's frame at the firing time. @param pose  the last one
/// before that time
RELIDAR_FUNCTION vec3 place_direction(SensorPose pose, float time_offset_s, vec3 d) {
    RELIDAR_EXACT vec3 rotated = d.x * pose.x + d.y * pose.y + d.z * pose.z;
    RELIDAR_EXACT vec3 turn = way_share(pose, time_offset_s) * pose.turn;
    return turned(turn, rotated);
}

/// Moves a point of the sensor's frame at the firing time.
RELIDAR_FUNCTION vec3 place_point(SensorPose pose, float time_offset_s, vec3 p) {
    RELIDAR_EXACT vec3 moved = pose.position_rest + way_share(pose, time_offset_s) * pose.way;
    vec3 rotated = place_direction(pose, time_offset_s, p);
    RELIDAR_EXACT vec3 result = pose.position + (moved + rotated);
    return result;
}

RELIDAR_SHARED_END
#endif
