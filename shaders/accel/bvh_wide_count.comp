// SPDX-License-Identifier: Apache-2.0
// Collapse, second of five kernels: inner children and leaf entries of the wide nodes to be, summed up within a tile of 4096 binary
// nodes. Workgroups of 256 threads. Input: demands. Output: offsets within the tile, sums of the tiles. Floor: 4 B read, 8 B written a
// binary node.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhWideParams);

void main() {
    uint tile = workgroup_index();
    if (tile >= params.n_tiles) return;
    uvec2 before = uvec2(0u);
    for (uint first = 0u; first < RELIDAR_BVH_TILE; first += RELIDAR_BVH_WORKGROUP) {
        uint node = tile * RELIDAR_BVH_TILE + first + scan_thread();
        uint demand = node < params.n_surfels ? params.demands.at[node] : 0u;
        uvec2 total, sum = workgroup_exclusive_add(uvec2(demand & 255u, demand >> 8), total);
        if (node < params.n_surfels) params.offsets.at[node] = before + sum;
        before += total;
    }
    if (scan_thread() == 0u) params.tiles.at[tile] = before;
}
