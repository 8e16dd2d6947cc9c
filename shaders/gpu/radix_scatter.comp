// SPDX-License-Identifier: Apache-2.0
// Stable radix sort, second half of a pass: moves the keys of a tile, in order, behind those of smaller digits and of earlier tiles.
// One thread a tile.
// Input: keys, values, n_keys, table. Output: sorted_keys, sorted_values.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/gpu.h"
RELIDAR_PARAMS(RadixSortParams);

void main() {
    uint tile = thread_index();
    if (tile >= params.n_tiles) return;
    uint first = tile * RELIDAR_SORT_TILE, end = min(first + RELIDAR_SORT_TILE, min(params.n_keys.at[0], params.capacity));
    if (first >= end) return;
    uint next[RELIDAR_SORT_DIGITS];
    for (uint d = 0u; d < RELIDAR_SORT_DIGITS; ++d) next[d] = params.table.at[d * params.n_tiles + tile];
    for (uint i = first; i < end; ++i) {
        uint key = params.keys.at[i];
        uint to = next[(key >> params.shift) % RELIDAR_SORT_DIGITS]++;
        params.sorted_keys.at[to] = key;
        params.sorted_values.at[to] = uint64_t(params.values) != 0ul ? params.values.at[i] : i;
    }
}
