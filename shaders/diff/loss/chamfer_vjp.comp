// SPDX-License-Identifier: Apache-2.0
// Computes the gradient of the Chamfer distance with respect to the rendered values. A
// simulated point a = o + r d has two gradients. The first is 2 (a - b) . d, where b is
// the measured point nearest to a. The second comes from measured points whose nearest
// point is a (kernel loss/chamfer). Adds both gradients and applies the derivative of the
// range r = D / W or r = D. One thread per ray. Input: rays, rendered, points, nearest,
// counts, d_nearest_simulated. Accumulated: upstream.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
#include "../../base/fixed_point.glsl"
RELIDAR_PARAMS(ChamferParams);

void main() {
    uint k = thread_index();
    if (k >= params.n_rays) return;
    uint b = params.nearest_measured.at[k];
    // The gradient is zero if this ray has no simulated point, or if no point was
    // measured.
    if (b == RELIDAR_NO_INDEX) return;
    vec3 difference = params.simulated.at[k] - params.measured.at[b];
    float asked = 2.0 * dot(difference, params.rays.at[params.first_ray + k * params.ray_stride].direction);
    float d_range = params.weight / max(min(params.counts.at[0], params.counts.at[1]), 1.0) *
                    (asked + read_fixed(params.d_nearest_simulated, k));
    RenderedRay r = params.rendered.at[k];
    float scale = params.normalised_depth != 0u ? 1.0 / r.weight : 1.0;
    params.upstream.at[k].depth += d_range * scale;
    if (params.normalised_depth != 0u) params.upstream.at[k].weight -= d_range * r.depth * scale * scale;
}
