// SPDX-License-Identifier: Apache-2.0
// First of two kernels that compute prefix sums. Computes the sum of each tile of 4096
// counts. One workgroup of 256 threads processes one tile. Input: counts. Output:
// tile_sums. Minimum traffic: 4 B read per count.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
RELIDAR_PARAMS(ScanParams);

void main() {
    uint tile = workgroup_index(), first = tile * RELIDAR_TILE_SIZE;
    if (first >= params.n) return;
    uint sum = 0u;
    for (uint i = first + ordered_thread(); i < min(first + RELIDAR_TILE_SIZE, params.n);
         i += RELIDAR_TILE_THREADS)
        sum += params.counts.at[params.offset + i * params.stride];
    uvec2 total;
    exclusive_sum(uvec2(sum, 0u), total);
    if (ordered_thread() == 0u) params.tile_sums.at[tile] = total.x;
}
