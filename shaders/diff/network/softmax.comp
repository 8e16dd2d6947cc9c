// SPDX-License-Identifier: Apache-2.0
// Computes the softmax p of each row, or its derivative d_x = p (d_p - sum p d_p). One
// subgroup processes one row. In place: values, d_values.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(SoftmaxParams);

/// Replaces a row x by exp(x - max x) / sum exp(x - max x). Subtracting the maximum
/// avoids an overflow.
void softmax_row(uint first) {
    float largest = -1e30, sum = 0.0;
    for (uint k = gl_SubgroupInvocationID; k < params.n; k += LANES)
        largest = max(largest, params.values.at[first + k]);
    largest = subgroupMax(largest);
    for (uint k = gl_SubgroupInvocationID; k < params.n; k += LANES)
        sum += exp(params.values.at[first + k] - largest);
    float scale = 1.0 / subgroupAdd(sum);
    for (uint k = gl_SubgroupInvocationID; k < params.n; k += LANES)
        params.values.at[first + k] = exp(params.values.at[first + k] - largest) * scale;
}

void softmax_vjp_row(uint first) {
    float sum = 0.0;
    for (uint k = gl_SubgroupInvocationID; k < params.n; k += LANES)
        sum += params.values.at[first + k] * params.d_values.at[first + k];
    sum = subgroupAdd(sum);
    for (uint k = gl_SubgroupInvocationID; k < params.n; k += LANES)
        params.d_values.at[first + k] = params.values.at[first + k] * (params.d_values.at[first + k] - sum);
}

void main() {
    uint row = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID;
    if (row >= params.n_rows) return;
    if (is_null(params.d_values)) softmax_row(row * params.n);
    else softmax_vjp_row(row * params.n);
}
