// SPDX-License-Identifier: Apache-2.0
// Radix sort, second of three kernels per pass: for each value of the digit, sums the
// keys in all earlier tiles. A subgroup processes one value. Input: n_keys. In place:
// counts. Output: totals. Minimum traffic: 8 B per entry of counts, 1/2 B per key.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
RELIDAR_PARAMS(RadixSortParams);
#include "radix.glsl"

void main() {
    uint tiles = n_tiles(), n_subgroups = gl_NumWorkGroups.x * gl_NumWorkGroups.y * gl_NumSubgroups;
    for (uint digit = workgroup_index() * gl_NumSubgroups + gl_SubgroupID; digit < RELIDAR_SORT_DIGITS;
         digit += n_subgroups) {
        uint before = 0u;
        for (uint first = 0u; first < tiles; first += gl_SubgroupSize) {
            uint tile = first + gl_SubgroupInvocationID, at = digit * tiles + tile;
            uint in_tile = tile < tiles ? params.counts.at[at] : 0u;
            uint sum = before + subgroupExclusiveAdd(in_tile);
            if (tile < tiles) params.counts.at[at] = sum;
            before += subgroupAdd(in_tile);
        }
        if (gl_SubgroupInvocationID == 0u) params.totals.at[digit] = before;
    }
}
