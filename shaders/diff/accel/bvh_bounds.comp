// SPDX-License-Identifier: Apache-2.0
// Computes the bounds of the box centres of each model. Ignores surfels that can never be
// hit. Later kernels compute Morton codes relative to these bounds. Workgroups of 256
// threads, 16 surfels per thread. Input: boxes, models. Accumulated: bounds. Memory
// traffic: at least 24 B read per surfel.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
#include "bvh_forest.glsl"
RELIDAR_PARAMS(BvhBoundsParams);

void extend_box(uint model, vec3 low, vec3 high) {
    for (uint c = 0u; c < 3u; ++c) {
        atomicMin(params.bounds.at[6 * model + c], to_ordered_bits(low[c]));
        atomicMin(params.bounds.at[6 * model + 3 + c], to_ordered_bits(-high[c]));
    }
}

void main() {
    uint base = workgroup_index() * RELIDAR_BVH_TILE + ordered_thread();
    uint model = 0u;
    Box bounds = make_empty_box();
    for (uint i = base; i < min(base - ordered_thread() + RELIDAR_BVH_TILE, params.n_surfels);
         i += RELIDAR_BVH_WORKGROUP) {
        Box b = load_box(params.boxes, i);
        if (is_empty(b)) continue;
        uint first_surfel = params.models.at[model].first_surfel;
        // Tests whether surfel i is outside the current model. If i is less than
        // first_surfel, the unsigned difference wraps to a large number.
        if (i - first_surfel >= params.models.at[model].n_surfels) {
            if (!is_empty(bounds)) extend_box(model, bounds.low, bounds.high);
            bounds = make_empty_box();
            model = find_model(params.models, params.n_models, i);
        }
        vec3 centre = 0.5 * b.low + 0.5 * b.high;
        bounds = join_boxes(bounds, Box(centre, centre));
    }
    if (subgroupAllEqual(model)) {
        bounds.low = subgroupMin(bounds.low);
        bounds.high = subgroupMax(bounds.high);
        if (!subgroupElect()) return;
    }
    if (!is_empty(bounds)) extend_box(model, bounds.low, bounds.high);
}
