// SPDX-License-Identifier: Apache-2.0
// Gradients of beams' rays as the sums of those of their parts: turning a beam turns them all. That parts point elsewhere by up to half the
// divergence is left out, a thousandth of the gradient. One thread a number of a beam. Input: d_parts. Output: d_beams.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/train.h"
RELIDAR_PARAMS(SplitBeamsVjpParams);

void main() {
    uint k = thread_index();
    if (k >= 6u * params.n_beams) return;
    float sum = 0.0;
    for (uint p = 0u; p < params.n_parts; ++p) sum += params.d_parts.at[6u * (k / 6u * params.n_parts + p) + k % 6u];
    params.d_beams.at[k] = sum;
}
