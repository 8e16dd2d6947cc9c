// SPDX-License-Identifier: Apache-2.0
// Second of two kernels that compute prefix sums. For each count, computes the sum of all
// earlier counts. One workgroup of 256 threads processes a tile of 4096 counts. Each
// subgroup processes a contiguous part of the tile. Input: counts, prefix sums of
// tile_sums. Output: prefix, total. Minimum traffic: 4 B read, 4 B written per count.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
RELIDAR_PARAMS(ScanParams);

const uint ROUNDS = RELIDAR_TILE_SIZE / RELIDAR_TILE_THREADS;

void main() {
    uint tile = workgroup_index();
    if (tile * RELIDAR_TILE_SIZE >= params.n) return;
    uint run = tile * RELIDAR_TILE_SIZE + gl_SubgroupID * gl_SubgroupSize * ROUNDS + gl_SubgroupInvocationID;
    uint before[ROUNDS], sum = 0u;  // Sum of the counts that this subgroup has processed.
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize,
             count = i < params.n ? params.counts.at[params.offset + i * params.stride] : 0u;
        before[r] = sum + subgroupExclusiveAdd(count);
        sum += subgroupAdd(count);
    }
    uvec2 in_tile;
    uint start = !is_null(params.tile_sums) ? params.tile_sums.at[tile] : 0u;
    // Adds the sums of earlier tiles and of earlier subgroups in this tile.
    uint run_start = start + earlier_sum(uvec2(sum, 0u), in_tile).x;
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        if (i < params.n) params.prefix.at[i] = run_start + before[r];
    }
    bool last = params.n - tile * RELIDAR_TILE_SIZE <= RELIDAR_TILE_SIZE;
    if (last && ordered_thread() == 0u && !is_null(params.total)) params.total.at[0] = start + in_tile.x;
}
