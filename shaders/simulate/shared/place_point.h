// SPDX-License-Identifier: Apache-2.0
// Where the ends of rays lie in the frame of points. C++ and GLSL compile these functions
// to the same single-precision operations in the same order, so that host and device
// compute the same bits. They use only additions, subtractions and multiplications,
// because Vulkan lets a device round everything else differently. No compiler may fuse a
// multiplication and an addition: see RELIDAR_EXACT and src/CMakeLists.txt.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_PLACE_POINT_H
#include "render.h"
#ifdef __cplusplus
#define RELIDAR_EXACT
#define RELIDAR_SHARED_FUNCTION inline
#else
#define RELIDAR_EXACT precise
#define RELIDAR_SHARED_FUNCTION
#endif

RELIDAR_SHARED_BEGIN

/// End of a ray in the sensor's frame at its firing time.
RELIDAR_SHARED_FUNCTION vec3 ray_end(vec3 origin, vec3 direction, float range_m) {
    RELIDAR_EXACT vec3 end = origin + range_m * direction;
    return end;
}

RELIDAR_SHARED_FUNCTION vec3 exact_cross(vec3 a, vec3 b) {
    RELIDAR_EXACT vec3 c = vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    return c;
}

/// sin(x) / x as a series of x^2, to 3e-7 for |x| <= pi.
RELIDAR_SHARED_FUNCTION float exact_sine_over(float x2) {
    RELIDAR_EXACT float sum = 1.0f - x2 * 0.00476190476f;
    sum = 1.0f - x2 * 0.00641025641f * sum;
    sum = 1.0f - x2 * 0.00909090909f * sum;
    sum = 1.0f - x2 * 0.0138888889f * sum;
    sum = 1.0f - x2 * 0.0238095238f * sum;
    sum = 1.0f - x2 * 0.05f * sum;
    sum = 1.0f - x2 * 0.166666667f * sum;
    return sum;
}

/// exp([w]x) p, for rotations of up to a full turn.
RELIDAR_SHARED_FUNCTION vec3 exact_turned(vec3 w, vec3 p) {
    RELIDAR_EXACT float half2 = 0.25f * (w.x * w.x + w.y * w.y + w.z * w.z);
    float quarter = exact_sine_over(0.25f * half2), sine = exact_sine_over(half2);  // of half the angle
    RELIDAR_EXACT float cosine = 1.0f - 0.5f * half2 * quarter * quarter;
    vec3 once = exact_cross(w, p), twice = exact_cross(w, once);
    RELIDAR_EXACT vec3 result = p + sine * (cosine * once + 0.5f * sine * twice);
    return result;
}

/// Share of the way to the next pose at a firing time.
RELIDAR_SHARED_FUNCTION float way_share(PointPose pose, float time_offset_s) {
    RELIDAR_EXACT float share = (time_offset_s - pose.time_offset_s) * pose.per_s;
    return share;
}

/// A direction in the sensor's frame at its firing time, in the frame of the points.
RELIDAR_SHARED_FUNCTION vec3 place_direction(PointPose pose, float time_offset_s, vec3 d) {
    RELIDAR_EXACT vec3 rotated = d.x * pose.x + d.y * pose.y + d.z * pose.z;
    RELIDAR_EXACT vec3 turn = way_share(pose, time_offset_s) * pose.turn;
    return exact_turned(turn, rotated);
}

/// A point in the sensor's frame at its firing time, in the frame of the points.
RELIDAR_SHARED_FUNCTION vec3 place_point(PointPose pose, float time_offset_s, vec3 p) {
    RELIDAR_EXACT vec3 moved = pose.position_rest + way_share(pose, time_offset_s) * pose.way;
    vec3 rotated = place_direction(pose, time_offset_s, p);
    RELIDAR_EXACT vec3 result = pose.position + (moved + rotated);
    return result;
}

RELIDAR_SHARED_END
#endif
