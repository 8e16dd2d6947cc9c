// SPDX-License-Identifier: Apache-2.0
// Terms of the parameters themselves, added to their gradients: actors' surfels outside their box or large against it, and the
// entropy of opacities. One thread a surfel of a model.
// Input: surfels, touched. Accumulated: d_surfels, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../common/kernel.glsl"
#include "../shared/loss.h"
#include "../common/atomic_add.glsl"
#include "../common/reduce.glsl"
RELIDAR_PARAMS(SurfelLossParams);

float scale_term(Floats log_scale, Floats d_log_scale, uint at, bool write) {
    float relative = exp(log_scale.at[at]) / params.largest_scale;
    if (!(relative > 1.0)) return 0.0;
    if (write) d_log_scale.at[at] += params.box_weight * relative;
    return relative - 1.0;
}

/// sum over x, y, z of max(0, |mean| / half size - 1), and the same for standard deviations. @return the term
float box_term(uint i, bool write) {
    float term = 0.0;
    for (uint axis = 0u; axis < 3u; ++axis) {
        float mean = params.surfels.mean.at[3u * i + axis], outside = abs(mean) / params.half_size[axis] - 1.0;
        if (!(outside > 0.0)) continue;
        term += outside;
        if (write) params.d_surfels.mean.at[3u * i + axis] += params.box_weight * sign(mean) / params.half_size[axis];
    }
    for (uint axis = 0u; axis < 2u; ++axis) term += scale_term(params.surfels.log_scale, params.d_surfels.log_scale, 2u * i + axis, write);
    if (!is_null(params.surfels.log_scale_w)) term += scale_term(params.surfels.log_scale_w, params.d_surfels.log_scale_w, i, write);
    return params.box_weight * term;
}

/// With x the logit, sigma = 1 / (1 + exp(-x)): entropy = ln(1 + exp(x)) - sigma x, derivative -x sigma (1 - sigma). @return the term
float entropy_term(uint i, bool write) {
    float x = params.surfels.opacity_logit.at[i], e = exp(-abs(x));
    float smaller = e / (1.0 + e);   // of sigma and 1 - sigma
    if (write) params.d_surfels.opacity_logit.at[i] -= params.entropy_weight * x * smaller * (1.0 - smaller);
    return params.entropy_weight * (log(1.0 + e) + smaller * abs(x));
}

void main() {
    uint k = thread_index(), i = params.first_surfel + k;
    bool is_surfel = k < params.n_surfels;
    bool write = is_surfel && (is_null(params.touched) || params.touched.at[i] != 0u);
    bool boxed = params.box_weight > 0.0 && params.half_size.x > 0.0;
    float box = is_surfel && boxed ? box_term(i, write) : 0.0;
    float entropy = is_surfel && params.entropy_weight > 0.0 ? entropy_term(i, write) : 0.0;
    add_to_sum(params.terms, kTerm_box, box);
    add_to_sum(params.terms, kTerm_entropy, entropy);
}
