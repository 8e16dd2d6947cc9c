// SPDX-License-Identifier: Apache-2.0
// Stable radix sort, first half of a pass: how often each value of a digit occurs in a tile of keys. One thread a tile.
// Input: keys, n_keys. Output: table.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/gpu.h"
RELIDAR_PARAMS(RadixSortParams);

void main() {
    uint tile = thread_index();
    if (tile >= params.n_tiles) return;
    uint counts[RELIDAR_SORT_DIGITS];
    for (uint d = 0u; d < RELIDAR_SORT_DIGITS; ++d) counts[d] = 0u;
    uint first = tile * RELIDAR_SORT_TILE, end = min(first + RELIDAR_SORT_TILE, min(params.n_keys.at[0], params.capacity));
    for (uint i = first; i < end; ++i) ++counts[(params.keys.at[i] >> params.shift) % RELIDAR_SORT_DIGITS];
    for (uint d = 0u; d < RELIDAR_SORT_DIGITS; ++d) params.table.at[d * params.n_tiles + tile] = counts[d];
}
