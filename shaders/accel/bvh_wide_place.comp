// SPDX-License-Identifier: Apache-2.0
// Collapse, third of four kernels: each wide node gives its inner children consecutive places behind the roots, in the order of the
// binary nodes, so that a build is repeatable. One thread a binary node. Input: tree, offsets, tiles. Output: places.
// Floor: 8 B a node read, 4 B a wide node written.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhWideParams);

void main() {
    uint node = thread_index();
    if (node >= params.n_surfels || !becomes_wide(params.tree, node)) return;
    uint slots[RELIDAR_BVH_WIDTH];
    uint n_slots = collect_slots(params.tree, node, slots);
    uint place = params.n_models + params.offsets.at[node].x + params.tiles.at[node / RELIDAR_BVH_TILE].x;
    for (uint s = 0u; s < n_slots; ++s)
        if (is_inner_slot(params.tree, slots[s])) params.tree.places.at[slots[s]] = place++;
}
