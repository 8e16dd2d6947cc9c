// SPDX-License-Identifier: Apache-2.0
// Collapse, first of four kernels: inner children and leaf entries of each wide node to be, summed up within a tile of 4096 binary
// nodes. Workgroups of 256 threads. Input: tree. Output: offsets within the tile, sums of the tiles. Floor: 8 B read, 8 B written a node.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhWideParams);

/// Inner children and leaf entries of a wide node.
uvec2 demand_of(uint node) {
    if (!becomes_wide(params.tree, node)) return uvec2(0u);
    uint slots[RELIDAR_BVH_WIDTH];
    uint n_slots = collect_slots(params.tree, node, slots);
    uvec2 demand = uvec2(0u);
    for (uint s = 0u; s < n_slots; ++s) {
        if (is_inner_slot(params.tree, slots[s])) ++demand.x;
        else demand.y += is_leaf(slots[s]) ? 1u : surfels_of(params.tree.states.at[slots[s]]);
    }
    return demand;
}

void main() {
    uint tile = workgroup_index();
    if (tile >= params.n_tiles) return;
    uvec2 before = uvec2(0u);
    for (uint first = 0u; first < RELIDAR_BVH_TILE; first += RELIDAR_BVH_WORKGROUP) {
        uint node = tile * RELIDAR_BVH_TILE + first + scan_thread();
        bool valid = node < params.n_surfels;
        uvec2 total, sum = workgroup_exclusive_add(valid ? demand_of(node) : uvec2(0u), total);
        if (valid) params.offsets.at[node] = before + sum;
        before += total;
    }
    if (scan_thread() == 0u) params.tiles.at[tile] = before;
}
