// SPDX-License-Identifier: Apache-2.0
// Loss that penalises surfels of an actor if they are outside the actor's box, or large
// compared with the box. Adds its derivatives to the parameter gradients. One thread per
// surfel of any model. Input: surfels, touched, models. Accumulated: d_surfels, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
RELIDAR_PARAMS(SurfelLossParams);

/// Returns the penalty for a standard deviation of a surfel that is too large.
/// @param max_scale_m largest standard deviation without a penalty, m
/// @param adds_gradient true: adds the derivative to d_log_scale
float scale_penalty(Floats log_scale, Floats d_log_scale, uint index, float max_scale_m, bool adds_gradient) {
    float relative = exp(log_scale.at[index]) / max_scale_m;
    if (!(relative > 1.0)) return 0.0;
    if (adds_gradient) d_log_scale.at[index] += params.box_weight * relative;
    return relative - 1.0;
}

/// Computes the penalty for a surfel outside the box of its actor. It is the sum over x,
/// y, z of max(0, |mean| / half size - 1), plus the penalty for large standard
/// deviations.
/// @param adds_gradient true: adds the derivatives to the gradients
/// @return penalty of the surfel
float box_loss(uint surfel, ModelEntry model, bool adds_gradient) {
    if (!all(greaterThan(model.half_size, vec3(0.0)))) return 0.0;  // the model has no box
    float term = 0.0, max_scale_m = params.box_scale_share * model.half_diagonal;
    for (uint axis = 0u; axis < 3u; ++axis) {
        float mean = params.surfels.mean.at[3u * surfel + axis],
              outside = abs(mean) / model.half_size[axis] - 1.0;
        if (!(outside > 0.0)) continue;
        term += outside;
        if (adds_gradient)
            params.d_surfels.mean.at[3u * surfel + axis] +=
                params.box_weight * sign(mean) / model.half_size[axis];
    }
    Floats log_scale = params.surfels.log_scale, d_log_scale = params.d_surfels.log_scale;
    for (uint axis = 0u; axis < 2u; ++axis)
        term += scale_penalty(log_scale, d_log_scale, 2u * surfel + axis, max_scale_m, adds_gradient);
    Floats third = params.surfels.log_scale_w;
    if (!is_null(third))
        term += scale_penalty(third, params.d_surfels.log_scale_w, surfel, max_scale_m, adds_gradient);
    return params.box_weight * term;
}

void main() {
    uint k = thread_index(), i = params.first_surfel + k;
    bool is_surfel = k < params.n_surfels;
    bool adds_gradient = is_surfel && (is_null(params.touched) || params.touched.at[i] != 0u);
    float box = 0.0;
    if (is_surfel)
        box = box_loss(i, params.models.at[find_model(params.models, params.n_models, i)], adds_gradient);
    add_to_sum(params.terms, kTerm_box, box);
}
