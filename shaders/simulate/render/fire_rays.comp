// SPDX-License-Identifier: Apache-2.0
// Transforms each ray into the world frame with the sensor's pose at the firing time of
// the ray. One thread per ray. Input: rays, poses. Output: fired.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "sensor_way.glsl"
RELIDAR_PARAMS(FireRaysParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    SensorRay ray = params.rays.at[i];
    SensorPose pose = find_pose(params.poses, params.n_poses, ray.time_offset_s);
    vec3 direction = to_world(pose, ray.time_offset_s, ray.direction);
    params.fired.at[i] =
        DeviceRay(place_point(pose, ray.time_offset_s, ray.origin), normalize(direction), ray.time_offset_s);
}
