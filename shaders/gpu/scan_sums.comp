// SPDX-License-Identifier: Apache-2.0
// Prefix sums, going up: sum of each block of 256 counts. One thread a block.
// Input: counts. Output: block_sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/gpu.h"
RELIDAR_PARAMS(ScanParams);

void main() {
    uint first = thread_index() * RELIDAR_SCAN_BLOCK;
    if (first >= params.n) return;
    uint end = min(first + RELIDAR_SCAN_BLOCK, params.n), sum = 0u;
    for (uint i = first; i < end; ++i) sum += params.counts.at[params.offset + i * params.stride];
    params.block_sums.at[first / RELIDAR_SCAN_BLOCK] = sum;
}
