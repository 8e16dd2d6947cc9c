// SPDX-License-Identifier: Apache-2.0
// Transforms points and directions from the sensor frame at their firing time to the
// frame in which the sensor poses are given. Between two poses, the sensor moves along a
// straight line and rotates about one axis at constant speed. The motion continues before
// the first pose and after the last pose.
//
// Host and device compute bit-identical results, because src/CMakeLists.txt disables
// fused multiply-add for place_points.cpp.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#include "../../base/shared/rotation.h"
#include "render.h"

RELIDAR_SHARED_BEGIN

/// Returns the end point of a ray in the sensor frame at the firing time.
RELIDAR_FUNCTION vec3 compute_ray_end(vec3 origin, vec3 direction, float range_m) {
    RELIDAR_EXACT vec3 end = origin + range_m * direction;
    return end;
}

/// Returns the fraction of the way from this sensor pose to the next pose at a firing
/// time: 0 at this pose, 1 at the next pose.
RELIDAR_FUNCTION float motion_fraction(SensorPose pose, float time_offset_s) {
    RELIDAR_EXACT float share = (time_offset_s - pose.time_offset_s) * pose.per_s;
    return share;
}

RELIDAR_FUNCTION vec3 to_world(SensorPose pose, float time_offset_s, vec3 direction) {
    RELIDAR_EXACT vec3 rotated = direction.x * pose.x + direction.y * pose.y + direction.z * pose.z;
    RELIDAR_EXACT vec3 turn = motion_fraction(pose, time_offset_s) * pose.turn_to_next;
    return rotate_point(turn, rotated);
}

RELIDAR_FUNCTION vec3 place_point(SensorPose pose, float time_offset_s, vec3 sensor_point) {
    RELIDAR_EXACT vec3 moved = pose.position_rest + motion_fraction(pose, time_offset_s) * pose.move_to_next;
    vec3 rotated = to_world(pose, time_offset_s, sensor_point);
    RELIDAR_EXACT vec3 result = pose.position + (moved + rotated);
    return result;
}

RELIDAR_SHARED_END
#endif
