// SPDX-License-Identifier: Apache-2.0
// Collapse, second of five kernels. Computes prefix sums of the inner children and leaf
// entries of the future wide nodes, within tiles of 4096 binary nodes. Workgroups of 256
// threads. Input: demands. Output: offsets within the tile, sums of the tiles. Memory
// traffic: at least 4 B read and 8 B written per binary node.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhWideParams);

uvec2 sums_of(uint demand) { return uvec2(demand & 255u, demand >> 8); }

void main() {
    uint tile = workgroup_index();
    if (tile >= params.n_tiles) return;
    // Each thread processes consecutive nodes, which fill two cache lines.
    const uint RUN = RELIDAR_BVH_TILE / RELIDAR_BVH_WORKGROUP;
    uint first = tile * RELIDAR_BVH_TILE + scan_thread() * RUN, end = min(first + RUN, params.n_surfels);
    uvec2 sums = uvec2(0u), total;
    for (uint node = first; node < end; ++node) sums += sums_of(params.demands.at[node]);
    uvec2 before = workgroup_exclusive_add(sums, total);
    for (uint node = first; node < end; ++node) {
        params.offsets.at[node] = before;
        before += sums_of(params.demands.at[node]);
    }
    if (scan_thread() == 0u) params.tiles.at[tile] = total;
}
