// SPDX-License-Identifier: Apache-2.0
// Collapse, second of five kernels: inner children and leaf entries of the wide nodes to
// be, summed up within a tile of 4096 binary nodes. Workgroups of 256 threads. Input:
// demands. Output: offsets within the tile, sums of the tiles. Floor: 4 B read, 8 B
// written a binary node.
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
    // consecutive nodes of a thread: two lines of the cache
    const uint RUN = RELIDAR_BVH_TILE / RELIDAR_BVH_WORKGROUP;
    uint first = tile * RELIDAR_BVH_TILE + scan_thread() * RUN, end = min(first + RUN, params.n_surfels);
    uvec2 own = uvec2(0u), total;
    for (uint node = first; node < end; ++node) own += sums_of(params.demands.at[node]);
    uvec2 before = workgroup_exclusive_add(own, total);
    for (uint node = first; node < end; ++node) {
        params.offsets.at[node] = before;
        before += sums_of(params.demands.at[node]);
    }
    if (scan_thread() == 0u) params.tiles.at[tile] = total;
}
