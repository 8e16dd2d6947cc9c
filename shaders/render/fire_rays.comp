// SPDX-License-Identifier: Apache-2.0
// The rays of a sensor in the world, each fired from where the sensor is at its time: between two poses, and beyond the first and last one,
// it moves along a straight line and turns about one axis, at even speed. One thread a ray.
// Input: rays, poses. Output: fired.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../common/rotation.glsl"
#include "../gaussian/quaternion.glsl"
#include "../shared/render.h"
RELIDAR_PARAMS(FireRaysParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    SensorRay ray = params.rays.at[i];
    uint k = 0u;
    while (k + 2u < params.n_poses && params.poses.at[k + 1u].time_offset_s <= ray.time_offset_s) ++k;
    SensorPose pose = params.poses.at[k];
    float s = pose.duration_s > 0.0 ? (ray.time_offset_s - pose.time_offset_s) / pose.duration_s : 0.0;
    mat3 rotation = rotation_matrix(pose.rotation);
    params.fired.at[i] = DeviceRay(pose.position + (s * pose.way + turned(s * pose.turn, rotation * ray.origin)),
                                   normalize(turned(s * pose.turn, rotation * ray.direction)));
}
