// SPDX-License-Identifier: Apache-2.0
// Radix sort, first of three kernels a pass: how many keys of a tile have each value of the digit. A workgroup of 256 threads a tile
// of 4096 keys. Input: keys. Output: counts. Floor: 8 B a key read.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
#include "bvh_sort.glsl"
RELIDAR_PARAMS(BvhSortParams);
shared uint histogram[RELIDAR_SORT_DIGITS];

void main() {
    uint tile = workgroup_index(), thread = scan_thread();
    histogram[thread] = 0u;
    barrier();
    uint end = min((tile + 1u) * RELIDAR_BVH_TILE, params.n);
    for (uint i = tile * RELIDAR_BVH_TILE + thread; i < end; i += RELIDAR_BVH_WORKGROUP) atomicAdd(histogram[digit_of(params.keys.at[i], params.shift)], 1u);
    barrier();
    if (tile < params.n_tiles) params.counts.at[thread * params.n_tiles + tile] = histogram[thread];
}
