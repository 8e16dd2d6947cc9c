// SPDX-License-Identifier: Apache-2.0
// Limits all opacities to a small value. Afterwards, training raises the opacity of
// surfels that the scans need. Surfels that stay faint are pruned later. One thread per
// surfel. In place: opacity_logit.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(ResetOpacityParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    // This comparison keeps a NaN, so that the next densification can count it.
    if (params.opacity_logit.at[i] > params.max_logit) params.opacity_logit.at[i] = params.max_logit;
}
