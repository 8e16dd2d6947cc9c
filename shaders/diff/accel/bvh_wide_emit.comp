// SPDX-License-Identifier: Apache-2.0
// Last of five kernels that convert binary trees to trees of wide nodes. Writes their
// children and leaf entries, but not the boxes. One thread per wide node in the queue.
// Input: tree, queue, slots, offsets, tiles, places, surfels, models. Output: wide.nodes,
// wide.order, wide.links.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhWideParams);

void main() {
    uint entry = thread_index();
    if (entry >= min(params.bound, params.wide.count.at[0])) return;
    uint node = params.queue.at[entry];
    if (node == RELIDAR_BVH_NO_NODE) return;
    uint place = entry < params.n_models ? entry : params.places.at[node];
    node &= ~RELIDAR_BVH_LEAF;
    uvec2 start = params.offsets.at[node] + params.tiles.at[node / RELIDAR_BVH_TILE];
    // find_model() expects the index of a surfel. The index of a node works too, because
    // it is also the index of a surfel of the same model.
    uint model = find_model(params.models, params.n_models, node);
    uint first_surfel = params.models.at[model].first_surfel;
    uint first_child = params.n_models + start.x;
    uint inner_mask = 0u, n_inner = 0u, n_entries = 0u;
    uint leaves[2] = uint[](0u, 0u);
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        uint slot = params.slots.at[8u * entry + s];
        if (slot == RELIDAR_BVH_NO_NODE) break;
        if (is_inner_slot(params.tree, slot)) {
            inner_mask |= 1u << s;
            params.wide.links.at[first_child + n_inner++] = uvec2(place, first_surfel);
            continue;
        }
        uint positions[RELIDAR_BVH_LEAF_SIZE];
        uint count = collect_surfels(params.tree, slot, positions);
        leaves[s / 4u] |= (n_entries | count << 5) << (8u * (s % 4u));
        for (uint k = 0u; k < count; ++k)
            params.wide.order.at[start.y + n_entries++] = params.surfels.at[positions[k]] - first_surfel;
    }
    if (entry < params.n_models) params.wide.links.at[place] = uvec2(RELIDAR_BVH_NO_NODE, first_surfel);
    params.wide.nodes.at[place].exponents = inner_mask << 24;
    params.wide.nodes.at[place].first_child = first_child;
    params.wide.nodes.at[place].first_leaf = start.y;
    params.wide.nodes.at[place].leaves = leaves;
}
