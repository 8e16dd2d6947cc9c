// SPDX-License-Identifier: Apache-2.0
// |ln(1 + r) - ln(1 + range)| on returned rays, r = D / W or D: near the sensor a difference in metres, far away a share of the range. And
// its derivative. One thread a ray.
// Input: rendered, targets. Accumulated: upstream, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../common/kernel.glsl"
#include "../shared/loss.h"
#include "../common/atomic_add.glsl"
#include "../common/reduce.glsl"
RELIDAR_PARAMS(RelativeRangeParams);

/// The term of a ray that returned; its derivative is added to the ray's gradient.
float relative_range_term(uint i, DeviceTarget target) {
    RenderedRay r = params.rendered.at[i];
    float scale = params.normalised_depth != 0u ? 1.0 / max(r.weight, 1e-3) : 1.0;
    float range = r.depth * scale, error = log((1.0 + range) / (1.0 + target.range_m));
    float d_range = params.weight * sign(error) / (1.0 + range);
    params.upstream.at[i].depth += d_range * scale;
    if (params.normalised_depth != 0u && r.weight > 1e-3) params.upstream.at[i].weight -= d_range * range * scale;
    return params.weight * abs(error);
}

void main() {
    uint i = thread_index();
    float term = 0.0;
    if (i < params.n_rays) {
        DeviceTarget target = params.targets.at[params.first_ray + i * params.ray_stride];
        if (target.weight > 0.0 && target.range_m > 0.0) term = relative_range_term(i, target);
    }
    add_to_sum(params.terms, kTerm_relative_range, term);
}
