// SPDX-License-Identifier: Apache-2.0
// Computes the pose of a sensor at the firing time of a ray. Between two poses, and
// beyond the first and last one, the sensor moves along a straight line and rotates about
// one axis, both at constant speed. Include after ../shared/render.h.
#ifndef RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#define RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#include "../../base/rotation.glsl"
#include "../../scene/gaussian/quaternion.glsl"

struct Firing {
    vec3 position;  // position of the previous pose
    vec3 moved;     // translation since the previous pose
    vec3 turn;      // rotation vector since the previous pose
    mat3 rotation;  // rotation of the previous pose
};

Firing firing_at(SensorPoses poses, uint n_poses, float time_offset_s) {
    uint k = 0u;
    while (k + 2u < n_poses && poses.at[k + 1u].time_offset_s <= time_offset_s) ++k;
    SensorPose pose = poses.at[k];
    float s = pose.duration_s > 0.0 ? (time_offset_s - pose.time_offset_s) / pose.duration_s : 0.0;
    return Firing(pose.position, s * pose.way, s * pose.turn, rotation_matrix(pose.rotation));
}

vec3 placed_point(Firing f, vec3 p) { return f.position + (f.moved + turned(f.turn, f.rotation * p)); }
vec3 placed_direction(Firing f, vec3 d) { return normalize(turned(f.turn, f.rotation * d)); }
#endif
