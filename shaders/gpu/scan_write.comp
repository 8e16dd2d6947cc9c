// SPDX-License-Identifier: Apache-2.0
// Prefix sums, going down: the sum of all counts before each. One thread a block of 256.
// Input: counts, block_sums (already prefix sums). Output: prefix.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/gpu.h"
RELIDAR_PARAMS(ScanParams);

void main() {
    uint block = thread_index(), first = block * RELIDAR_SCAN_BLOCK;
    if (first >= params.n) return;
    uint end = min(first + RELIDAR_SCAN_BLOCK, params.n);
    uint sum = uint64_t(params.block_sums) != 0ul ? params.block_sums.at[block] : 0u;
    for (uint i = first; i < end; ++i) {
        uint count = params.counts.at[params.offset + i * params.stride];   // before prefix, which may lie over it
        params.prefix.at[i] = sum;
        sum += count;
    }
    if (end == params.n && uint64_t(params.prefix) != uint64_t(params.counts)) params.prefix.at[end] = sum;
}
