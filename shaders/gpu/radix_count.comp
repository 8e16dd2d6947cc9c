// SPDX-License-Identifier: Apache-2.0
// First of three kernels of a radix sort pass. Counts the keys of each tile by the value
// of their digit. A workgroup of 256 threads processes a tile of 4096 keys. Input:
// n_keys, keys. Output: counts. Minimum traffic: each key is read once.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
RELIDAR_PARAMS(RadixSortParams);
#include "radix.glsl"
shared uint histogram[RELIDAR_SORT_DIGITS];

void main() {
    uint tile = workgroup_index(), thread = ordered_thread(), n = n_keys();
    if (tile >= n_tiles()) return;
    histogram[thread] = 0u;
    barrier();
    uint first = tile * RELIDAR_TILE_SIZE;
    for (uint i = first + thread; i < min(first + RELIDAR_TILE_SIZE, n); i += RELIDAR_TILE_THREADS)
        atomicAdd(histogram[radix_digit(i)], 1u);
    barrier();
    // One thread per digit value. The counts of a digit are consecutive, so that
    // radix_scan can sum them over the tiles.
    params.counts.at[thread * n_tiles() + tile] = histogram[thread];
}
