// SPDX-License-Identifier: Apache-2.0
// Radix sort, second of three kernels a pass: for each value of the digit, how many keys of it are in the tiles before. A subgroup a value. Counts: in place; totals: output. Floor: 8 B an entry of counts, 1/2 B a key.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhSortParams);

void main() {
    uint n_subgroups = gl_NumWorkGroups.x * gl_NumWorkGroups.y * gl_NumSubgroups;
    for (uint digit = workgroup_index() * gl_NumSubgroups + gl_SubgroupID; digit < RELIDAR_SORT_DIGITS; digit += n_subgroups) {
        uint before = 0u;
        for (uint first = 0u; first < params.n_tiles; first += gl_SubgroupSize) {
            uint tile = first + gl_SubgroupInvocationID, at = digit * params.n_tiles + tile;
            uint in_tile = tile < params.n_tiles ? params.counts.at[at] : 0u;
            uint sum = before + subgroupExclusiveAdd(in_tile);
            if (tile < params.n_tiles) params.counts.at[at] = sum;
            before += subgroupAdd(in_tile);
        }
        if (gl_SubgroupInvocationID == 0u) params.totals.at[digit] = before;
    }
}
