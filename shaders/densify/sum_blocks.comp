// SPDX-License-Identifier: Apache-2.0
// Sums of blocks of values: the first half of a prefix sum. One thread a block, so that any workgroup size will do; a densification
// comes once in a hundred steps, and this is the smallest part of it. Input: values. Output: sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(SumBlocksParams);

void main() {
    uint first = thread_index() * RELIDAR_DENSIFY_BLOCK;
    if (first >= params.n) return;
    uint last = min(first + RELIDAR_DENSIFY_BLOCK, params.n);
    uint sum = 0u;
    for (uint i = first; i < last; ++i) sum += params.values.at[i];
    params.sums.at[first / RELIDAR_DENSIFY_BLOCK] = sum;
}
