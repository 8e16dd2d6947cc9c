// SPDX-License-Identifier: Apache-2.0
// Fourth of five kernels that convert binary trees to trees of wide nodes. Assigns
// consecutive indices to the inner children of each wide node, in the order of the binary
// nodes. One thread per wide node in the queue. Input: queue, slots, offsets, tiles.
// Output: places.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhWideParams);

void main() {
    uint entry = thread_index();
    if (entry >= min(params.bound, params.wide.count.at[0])) return;
    uint node = params.queue.at[entry];
    if (node == RELIDAR_BVH_NO_NODE) return;
    node &= ~RELIDAR_BVH_LEAF;
    // The roots are first. x is the number of inner children of all earlier binary
    // nodes: those in the same tile, and those in earlier tiles.
    uint place = params.n_models + params.offsets.at[node].x + params.tiles.at[node / RELIDAR_BVH_TILE].x;
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        uint slot = params.slots.at[8u * entry + s];
        if (slot != RELIDAR_BVH_NO_NODE && is_inner_slot(params.tree, slot)) params.places.at[slot] = place++;
    }
}
