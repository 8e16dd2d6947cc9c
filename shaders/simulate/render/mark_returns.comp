// SPDX-License-Identifier: Apache-2.0
// Marks the rays that produce a return. Such a ray hit a surface and has a drop
// probability below the threshold. Kernel measure_rays gives probability 1 to rays
// without a hit. These rays never return, because the network cannot change this value.
// One thread per ray. Input: measured, drop_prob. Output: marks.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/render.h"
RELIDAR_PARAMS(MarkReturnsParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    MeasuredRay m = params.measured.at[i];
    float drop_prob = params.has_network != 0u && m.drop_prob < 1.0 ? params.drop_prob.at[i] : m.drop_prob;
    float range_m = params.use_image_range != 0u ? m.range_m : m.median_range_m;
    params.marks.at[i] = drop_prob < params.drop_threshold && range_m > 0.0 ? 1u : 0u;
}
