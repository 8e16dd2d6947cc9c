// SPDX-License-Identifier: Apache-2.0
// Adds partial sums in a fixed order, so that the result is the same in every run. One
// thread per entry. Input: partial. Output: sum.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(SumPartsParams);

void main() {
    uint i = thread_index();
    if (i >= params.n) return;
    float sum = 0.0;
    for (uint part = 0u; part < params.n_parts; ++part) sum += params.partial.at[part * params.n + i];
    params.sum.at[i] = sum;
}
