// SPDX-License-Identifier: Apache-2.0
// Computes the ray-drop probability as the sigmoid of the network's logit, and its
// cross-entropy loss (paper, Eq. 13). One subgroup processes one part of the pixels.
//   x = logit + start,   probability = 1 / (1 + exp(-x)),
//   d_x = weight (probability - target)
//
// Input: logit, start, target. Output: d_logit, probability, partial.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(DropLossParams);

/// Returns the cross-entropy of a pixel, and 1 if the prediction (dropped or returned) is
/// correct, otherwise 0.
vec2 cross_entropy(uint pixel, float logit, float probability) {
    float target = is_null(params.target) ? -1.0 : params.target.at[pixel];
    bool known = target >= 0.0;
    if (!is_null(params.d_logit))
        params.d_logit.at[pixel] = known ? params.weight * (probability - target) : 0.0;
    float entropy = max(logit, 0.0) - logit * target + log(1.0 + exp(-abs(logit)));  // avoids overflow
    return known ? vec2(entropy, (logit > 0.0) == (target > 0.5) ? 1.0 : 0.0) : vec2(0.0);
}

void main() {
    uint part = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID;
    if (part >= params.n_parts) return;
    // The first n % n_parts parts have one pixel more.
    uint begin = params.n / params.n_parts * part + min(part, params.n % params.n_parts);
    uint end = begin + params.n / params.n_parts + (part < params.n % params.n_parts ? 1u : 0u);
    vec2 sum = vec2(0.0);
    for (uint i = begin + gl_SubgroupInvocationID; i < end; i += LANES) {
        float x = params.logit.at[i];
        if (!is_null(params.start)) x += params.start.at[i];
        float probability = 1.0 / (1.0 + exp(-x));
        if (!is_null(params.probability)) params.probability.at[i] = probability;
        sum += cross_entropy(i, x, probability);
    }
    sum = subgroupAdd(sum);
    if (gl_SubgroupInvocationID == 0u) {
        params.partial.at[2u * part] = sum.x;
        params.partial.at[2u * part + 1u] = sum.y;
    }
}
