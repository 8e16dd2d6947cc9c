// SPDX-License-Identifier: Apache-2.0
// Lowers all opacities to a small value. Only surfels that the scans need recover from
// it, and the others are pruned later. One thread per surfel. In place: opacity_logit.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ResetOpacityParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    // Does not change a NaN, because the next densification counts NaNs.
    if (params.opacity_logit.at[i] > params.max_logit) params.opacity_logit.at[i] = params.max_logit;
}
