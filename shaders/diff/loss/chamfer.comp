// SPDX-License-Identifier: Apache-2.0
// Computes the Chamfer distance between simulated and measured points (paper, Eq. 11),
// using the nearest points in both directions. Each measured point b also adds a gradient
// to its nearest simulated point a, whose ray has the range r_a and the direction d_a:
// dL/dr_a += 2 (a - b) . d_a. The gradients are summed in fixed-point numbers. Then the
// result does not depend on the order of addition. One thread per ray. Input: rays,
// points, nearest, counts. Accumulated: d_nearest_simulated, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
#include "../../base/fixed_point.glsl"
RELIDAR_PARAMS(ChamferParams);

void main() {
    uint k = thread_index();
    float squares_m2 = 0.0;
    if (k < params.n_rays) {
        uint b = params.nearest_measured.at[k], a = params.nearest_simulated.at[k];
        if (b != RELIDAR_NO_INDEX) {
            // From simulated point k to the nearest measured point b.
            vec3 difference = params.simulated.at[k] - params.measured.at[b];
            squares_m2 += dot(difference, difference);
        }
        if (a != RELIDAR_NO_INDEX) {
            // From measured point k to the nearest simulated point a.
            vec3 difference = params.simulated.at[a] - params.measured.at[k];
            squares_m2 += dot(difference, difference);
            add_fixed(
                params.d_nearest_simulated, a,
                2.0 * dot(difference, params.rays.at[params.first_ray + a * params.ray_stride].direction));
        }
    }
    // Eq. 11 divides by the number of points of the smaller cloud.
    float weight = params.weight / max(min(params.counts.at[0], params.counts.at[1]), 1.0);
    add_to_sum(params.terms, kTerm_chamfer, weight * squares_m2);
}
