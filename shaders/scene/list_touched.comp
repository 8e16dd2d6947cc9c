// SPDX-License-Identifier: Apache-2.0
// Numbers of the rows that have a gradient, side by side, so that every lane of the steps
// over them has one: lanes of a CPU that have nothing to do cost as much as the others.
// One thread a stretch of rows. The order of stretches differs from run to run, and no
// result depends on it. Input: touched. Output: rows, count (zero before).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/scene.h"
RELIDAR_PARAMS(ListTouchedParams);

void main() {
    uint first = thread_index() * RELIDAR_LIST_STRETCH,
         end = min(first + RELIDAR_LIST_STRETCH, params.n_rows), n = 0u;
    for (uint row = first; row < end; ++row) n += params.touched.at[row];
    if (n == 0u) return;
    uint at = atomicAdd(params.count.at[0], n);
    for (uint row = first; row < end; ++row)
        if (params.touched.at[row] != 0u) params.rows.at[at++] = row;
}
