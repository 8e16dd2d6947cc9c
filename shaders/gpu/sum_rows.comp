// SPDX-License-Identifier: Apache-2.0
// Sums blocks of rows, each column for itself and in order, so that the result is the same in every run. One thread a column of a block.
// Input: rows. Output or accumulated: sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/gpu.h"
RELIDAR_PARAMS(SumRowsParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_blocks * params.width) return;
    uint first = i / params.width * params.block, end = min(first + params.block, params.n);
    float sum = params.accumulate != 0u ? params.sums.at[i] : 0.0;
    for (uint row = first; row < end; ++row) sum += params.rows.at[row * params.width + i % params.width];
    params.sums.at[i] = sum;
}
