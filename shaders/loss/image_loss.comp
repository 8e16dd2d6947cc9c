// SPDX-License-Identifier: Apache-2.0
// Image losses (Eq. 10) and their derivative: depth L1 and intensity L1 on returned rays, ray-drop cross-entropy of the softmax
// of the two blended logits (M6) on all known rays. One thread a ray.
// Input: rendered, targets. Output: upstream, terms (summed in order by gpu/sum_rows).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/loss.h"
RELIDAR_PARAMS(ImageLossParams);

/// Depth L1 of D or D / W. @return the term
float depth_term(RenderedRay r, float range_m, inout RayGradient g) {
    float weight = max(r.weight, 1e-3);
    float scale = params.normalised_depth != 0u ? 1.0 / weight : 1.0;
    float error = r.depth * scale - range_m;
    float d_error = params.depth_weight * sign(error);
    g.depth += d_error * scale;
    if (params.normalised_depth != 0u && r.weight > 1e-3) g.weight -= d_error * r.depth * scale * scale;
    return params.depth_weight * abs(error);
}

/// -log of the probability of what happened; log(1 + exp(x)) without overflow. @return the term
float drop_term(RenderedRay r, bool dropped, inout RayGradient g) {
    float x = r.drop_logit - r.hit_logit;
    float probability = 1.0 / (1.0 + exp(-x));
    float d_x = params.drop_weight * (probability - (dropped ? 1.0 : 0.0));
    g.drop_logit += d_x;
    g.hit_logit -= d_x;
    float z = dropped ? -x : x;
    return params.drop_weight * (max(z, 0.0) + log(1.0 + exp(-abs(z))));
}

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    RayTarget target = params.targets.at[params.first_ray + i * params.ray_stride];
    RenderedRay r = params.rendered.at[i];
    RayGradient g = RayGradient(0.0, 0.0, 0.0, 0.0, 0.0);
    float terms[RELIDAR_LOSS_TERMS] = float[](0.0, 0.0, 0.0, 0.0);
    if (target.weight > 0.0) {
        bool dropped = !(target.range_m > 0.0);
        if (!dropped) {
            terms[0] = depth_term(r, target.range_m, g);
            float error = r.intensity - target.intensity;
            g.intensity += params.intensity_weight * sign(error);
            terms[1] = params.intensity_weight * abs(error);
            float missing = 1.0 - r.weight;
            g.weight -= 2.0 * params.opacity_weight * missing;
            terms[3] = params.opacity_weight * missing * missing;
        }
        terms[2] = drop_term(r, dropped, g);
    }
    params.upstream.at[i] = g;
    for (uint k = 0u; k < RELIDAR_LOSS_TERMS; ++k) params.terms.at[RELIDAR_LOSS_TERMS * i + k] = terms[k];
}
