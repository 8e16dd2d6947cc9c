// SPDX-License-Identifier: Apache-2.0
// Moves one array of surfel data into the order after densification. Each surfel has one
// row in the array. Surviving rows keep their order, and each copy follows its original,
// so that surfels that are close in space stay close in memory. One thread per surfel.
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
    // If `zero_new` is set, new surfels start with zeros (moments of Adam). A split also
    // changes row 0, the original. A clone does not.
    bool changed = action == RELIDAR_DENSIFY_SPLIT;
    for (uint row = 0u; row < params.n_rows.at[i]; ++row) {
        bool zero = params.zero_new != 0u && (changed || row > 0u);
        uint target = (params.starts.at[i] + row) * params.stride;
        for (uint k = 0u; k < params.stride; ++k)
            params.to.at[target + k] = zero ? 0u : params.from.at[i * params.stride + k];
    }
}
