// SPDX-License-Identifier: Apache-2.0
// Computes the simulated and the measured point of each ray. All points are relative to
// the origin of the first ray of the batch, to keep float precision. One thread per ray.
// Input: rays, rendered, targets. Output: simulated, measured. Accumulated: counts.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
RELIDAR_PARAMS(ChamferPointsParams);

// If the blending weights of a ray sum to less, its simulated range is unreliable.
const float kLeastWeight = 0.1;

/// Returns the simulated range of a ray in m. Returns 0 if the range is unreliable, NaN,
/// or probably not measured (ray drop).
float simulated_range(RenderedRay ray) {
    if (!(ray.weight > kLeastWeight) || !(ray.drop_logit < ray.hit_logit)) return 0.0;
    return params.normalised_depth != 0u ? ray.depth / ray.weight : ray.depth;
}

void main() {
    uint k = thread_index();
    vec2 is_point = vec2(0.0);
    if (k < params.n_rays) {
        uint i = params.first_ray + k * params.ray_stride;
        DeviceTarget target = params.targets.at[i];
        DeviceRay ray = params.rays.at[i];
        // subtracts the first ray's origin, to keep float precision
        vec3 origin = ray.origin - params.rays.at[params.first_ray].origin;
        // Simulated and measured range, m. 0 means that the ray has no such point.
        vec2 range =
            target.weight > 0.0 ? vec2(simulated_range(params.rendered.at[k]), target.range_m) : vec2(0.0);
        if (range.x > 0.0) is_point.x = 1.0;
        if (range.y > 0.0) is_point.y = 1.0;
        params.simulated.at[k] = is_point.x > 0.0 ? origin + range.x * ray.direction : vec3(RELIDAR_NO_POINT);
        params.measured.at[k] = is_point.y > 0.0 ? origin + range.y * ray.direction : vec3(RELIDAR_NO_POINT);
    }
    add_to_sum(params.counts, 0u, is_point.x);
    add_to_sum(params.counts, 1u, is_point.y);
}
