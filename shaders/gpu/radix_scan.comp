// SPDX-License-Identifier: Apache-2.0
// Second of three kernels of a radix sort pass. For each digit value and tile, computes
// the number of keys with this digit value in all earlier tiles. One subgroup processes
// one digit value. Input: n_keys. In place: counts. Output: totals.
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
