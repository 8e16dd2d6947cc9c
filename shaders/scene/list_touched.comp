// SPDX-License-Identifier: Apache-2.0
// Writes a list of the surfels that have a gradient, so that later kernels process only
// these surfels. Each thread checks RELIDAR_LIST_STRETCH surfels. The order of the list
// differs between runs, but no result depends on it. Input: touched. Output: rows, count
// (zero before).
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
