// SPDX-License-Identifier: Apache-2.0
// Computes the sort key of every surfel. The high bits contain the model index. The low
// bits contain the Morton code of the mean, with 13 bits per axis. All axes use the same
// cell size, so that the first splits divide the longest edge of the model. One thread
// per surfel. Input: records, models, bounds. Output: keys, initial values of other_ends
// and demands.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_morton.glsl"
RELIDAR_PARAMS(BvhKeysParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint model = find_model(params.models, params.n_models, i);
    // Upper bounds have the opposite sign, because atomicMin() computes all bounds.
    vec3 low, high;
    for (uint c = 0u; c < 3u; ++c) {
        low[c] = from_ordered(params.bounds.at[6 * model + c]);
        high[c] = -from_ordered(params.bounds.at[6 * model + 3 + c]);
    }
    uvec3 cell = morton_cell(params.records.at[i].mean, low, high, RELIDAR_BVH_MORTON_BITS);
    uint coarse = interleave_bits(cell >> 5), fine = interleave_bits(cell & 31u);  // 24 bits and 15 bits
    // A key has 64 bits, lower word first: Morton code in bits 0-38, then the model.
    params.keys.at[i] = uvec2(coarse << 15 | fine, coarse >> 17 | model << 7);
    params.other_ends.at[i] = RELIDAR_BVH_NO_NODE;
    params.demands.at[i] = 0u;
}
