// SPDX-License-Identifier: Apache-2.0
// Chamfer distance (Eq. 11) from the nearest points both ways, and its derivative with respect to the range of every simulated point
// a = o + r d, whether it asked (a to b) or was found (b to a): dL/dr += 2 (a - b) . d. One thread a ray.
// Input: rays, rendered, points, nearest, counts. Accumulated: upstream, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../common/kernel.glsl"
#include "../shared/loss.h"
#include "../common/atomic_add.glsl"
#include "../common/reduce.glsl"
RELIDAR_PARAMS(ChamferParams);

const uint kDepth = 0u, kWeight = 1u, kFloats = 5u;   // of RayGradient

/// One pair, with its derivative. @param a index of the simulated, b of the measured point @return the term
float pair_term(uint a, uint b, float weight) {
    vec3 difference = params.simulated.at[a] - params.measured.at[b];
    float d_range = 2.0 * weight * dot(difference, params.rays.at[params.first_ray + a * params.ray_stride].direction);
    RenderedRay r = params.rendered.at[a];
    if (params.normalised_depth != 0u) {
        atomic_add(params.upstream, kFloats * a + kDepth, d_range / r.weight);
        atomic_add(params.upstream, kFloats * a + kWeight, -d_range * r.depth / (r.weight * r.weight));
    } else {
        atomic_add(params.upstream, kFloats * a + kDepth, d_range);
    }
    return weight * dot(difference, difference);
}

void main() {
    uint k = thread_index();
    float term = 0.0;
    if (k < params.n_rays) {
        float weight = params.weight / max(min(params.counts.at[0], params.counts.at[1]), 1.0);
        uint to_measured = params.nearest_measured.at[k], to_simulated = params.nearest_simulated.at[k];
        if (to_measured != RELIDAR_NO_INDEX) term += pair_term(k, to_measured, weight);
        if (to_simulated != RELIDAR_NO_INDEX) term += pair_term(to_simulated, k, weight);
    }
    add_to_sum(params.terms, RELIDAR_TERM_CHAMFER, term);
}
