// SPDX-License-Identifier: Apache-2.0
// Radix sort, second of three kernels a pass: for each value of the digit, how many keys of it are in the tiles before. A workgroup
// of 256 threads a value. Counts: in place; totals: output. Floor: 8 B an entry of counts, 1/2 B a key.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhSortParams);

void main() {
    uint digit = workgroup_index(), thread = scan_thread();
    if (digit >= RELIDAR_SORT_DIGITS) return;
    uint before = 0u;
    for (uint first = 0u; first < params.n_tiles; first += RELIDAR_BVH_WORKGROUP) {
        uint tile = first + thread, at = digit * params.n_tiles + tile;
        uvec2 total;
        uint in_tiles = tile < params.n_tiles ? params.counts.at[at] : 0u;
        uint sum = workgroup_exclusive_add(uvec2(in_tiles, 0u), total).x;
        if (tile < params.n_tiles) params.counts.at[at] = before + sum;
        before += total.x;
    }
    if (thread == 0u) params.totals.at[digit] = before;
}
