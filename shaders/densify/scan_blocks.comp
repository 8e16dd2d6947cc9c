// SPDX-License-Identifier: Apache-2.0
// Exclusive prefix sum of values, given where each block starts: the second half. One thread a block.
// Input: values, block_starts. Output: starts.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ScanBlocksParams);

void main() {
    uint first = thread_index() * RELIDAR_DENSIFY_BLOCK;
    if (first >= params.n) return;
    uint last = min(first + RELIDAR_DENSIFY_BLOCK, params.n);
    uint sum = uint64_t(params.block_starts) == 0ul ? 0u : params.block_starts.at[first / RELIDAR_DENSIFY_BLOCK];
    for (uint i = first; i < last; ++i) {
        uint value = params.values.at[i];
        params.starts.at[i] = sum;
        sum += value;
    }
}
