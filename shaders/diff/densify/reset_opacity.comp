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
    uint i = get_thread_index();
    if (i >= params.n_surfels) return;
    // The comparison is false for a NaN, so that the NaN stays. The next densification
    // counts NaNs.
    if (params.opacity_logit.at[i] > params.max_logit) params.opacity_logit.at[i] = params.max_logit;
}
