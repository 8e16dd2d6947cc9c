// SPDX-License-Identifier: Apache-2.0
// Transforms rays and their end points from the moving sensor frame to the frame of the
// sensor's poses. Between two poses, the sensor moves at constant speed along a straight
// line and turns about one axis. Beyond the first and last pose this motion continues.
// Host and device compute the same bits, because src/CMakeLists.txt forbids fused
// multiplications and additions for place_points.cpp.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#include "../../base/shared/rotation.h"
#include "render.h"

RELIDAR_SHARED_BEGIN

/// Returns the end point of a ray in the sensor frame at its firing time.
RELIDAR_FUNCTION vec3 ray_end(vec3 origin, vec3 direction, float range_m) {
    RELIDAR_EXACT vec3 end = origin + range_m * direction;
    return end;
}

/// Returns the fraction of the way from a pose to the next one at a firing time.
RELIDAR_FUNCTION float way_share(SensorPose pose, float time_offset_s) {
    RELIDAR_EXACT float share = (time_offset_s - pose.time_offset_s) * pose.per_s;
    return share;
}

/// Rotates a direction from the sensor frame at the firing time.
/// @param pose  last pose before the firing time
RELIDAR_FUNCTION vec3 place_direction(SensorPose pose, float time_offset_s, vec3 d) {
    RELIDAR_EXACT vec3 rotated = d.x * pose.x + d.y * pose.y + d.z * pose.z;
    RELIDAR_EXACT vec3 turn = way_share(pose, time_offset_s) * pose.turn;
    return turned(turn, rotated);
}

/// Transforms a point from the sensor frame at the firing time.
RELIDAR_FUNCTION vec3 place_point(SensorPose pose, float time_offset_s, vec3 p) {
    RELIDAR_EXACT vec3 moved = pose.position_rest + way_share(pose, time_offset_s) * pose.way;
    vec3 rotated = place_direction(pose, time_offset_s, p);
    RELIDAR_EXACT vec3 result = pose.position + (moved + rotated);
    return result;
}

RELIDAR_SHARED_END
#endif
