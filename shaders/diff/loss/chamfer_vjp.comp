// SPDX-License-Identifier: Apache-2.0
// Derivative of the Chamfer distance with respect to the rendered values. For a simulated
// point a = o + r d, sums the gradient as a query, 2 (a - b) . d, and the gradient as a
// nearest point (loss/chamfer). Then applies the derivative of r = D / W or D. One thread
// per ray. Input: rays, rendered, points, nearest, counts, d_found. Accumulated:
// upstream.
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
    // Returns if the ray has no simulated point or no measured point exists. Then this
    // point is not the nearest point of any measured point either.
    if (b == RELIDAR_NO_INDEX) return;
    vec3 difference = params.simulated.at[k] - params.measured.at[b];
    float asked = 2.0 * dot(difference, params.rays.at[params.first_ray + k * params.ray_stride].direction);
    float d_range = params.weight / max(min(params.counts.at[0], params.counts.at[1]), 1.0) *
                    (asked + read_fixed(params.d_found, k));
    RenderedRay r = params.rendered.at[k];
    float scale = params.normalised_depth != 0u ? 1.0 / r.weight : 1.0;
    params.upstream.at[k].depth += d_range * scale;
    if (params.normalised_depth != 0u) params.upstream.at[k].weight -= d_range * r.depth * scale * scale;
}
