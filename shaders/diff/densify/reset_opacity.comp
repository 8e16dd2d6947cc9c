// SPDX-License-Identifier: Apache-2.0
// Opacities are lowered to a small value, from which only surfels that the scans need
// recover; the others are pruned. One thread a surfel. In place: opacity_logit.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ResetOpacityParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    // a NaN stays one: the next densification counts it
    if (params.opacity_logit.at[i] > params.max_logit) params.opacity_logit.at[i] = params.max_logit;
}
