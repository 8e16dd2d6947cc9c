// SPDX-License-Identifier: Apache-2.0
// Writes the points of all rays with a return to a contiguous array, in the order of the
// rays. Points are in the frame in which the sensor poses are given. Also writes the
// ranges of n_sampled evenly spaced rays. One thread per ray. Input: rays, measured,
// poses, marks, point_index. Output: points, sampled_m.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "sensor_way.glsl"
RELIDAR_PARAMS(GatherPointsParams);

/// The host needs the ranges of n_sampled evenly spaced rays. Returns the index of one of
/// these rays: floor(index * n_rays / n_sampled). Computes quotient and
/// remainder of n_rays / n_sampled separately to avoid an overflow of 32 bits.
uint sampled_ray(uint index) {
    return index * (params.n_rays / params.n_sampled) +
           index * (params.n_rays % params.n_sampled) / params.n_sampled;
}

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    if (i < params.n_sampled) params.sampled_m.at[i] = params.measured.at[sampled_ray(i)].median_range_m;
    if (params.marks.at[i] == 0u) return;
    SensorRay ray = params.rays.at[i];
    MeasuredRay m = params.measured.at[i];
    SensorPose pose = find_pose(params.poses, params.n_poses, ray.time_offset_s);
    vec3 seen = compute_ray_end(ray.origin, ray.direction,
                                params.use_image_range != 0u ? m.range_m : m.median_range_m);
    params.points.at[params.point_index.at[i]] = ReturnedPoint(
        place_point(pose, ray.time_offset_s, seen), m.intensity, ray.time_offset_s, ray.channel, m.instance);
}
