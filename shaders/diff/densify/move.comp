// SPDX-License-Identifier: Apache-2.0
// Moves the rows of one array (a parameter group, a moment or a statistic) into the new
// order. Survivors keep their order and copies follow their original, so that neighbours
// in space remain neighbours in memory. Values are copied as bits. One thread per surfel.
// Input: from, action, n_rows, starts. Output: to.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(MoveParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint action = params.action.at[i];
    bool changed = action == RELIDAR_DENSIFY_SPLIT;
    for (uint row = 0u; row < params.n_rows.at[i]; ++row) {
        bool zero = params.fresh != 0u && (changed || row > 0u);
        uint target = (params.starts.at[i] + row) * params.stride;
        for (uint k = 0u; k < params.stride; ++k)
            params.to.at[target + k] = zero ? 0u : params.from.at[i * params.stride + k];
    }
}
