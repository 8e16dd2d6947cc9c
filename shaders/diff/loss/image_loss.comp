// SPDX-License-Identifier: Apache-2.0
// Computes the image losses (paper, Eq. 10) and their derivatives. Rays with a return
// have an L1 loss of the depth and an L1 or Huber loss of the intensity. All rays with a
// known measurement have a ray-drop loss. It is the cross-entropy of the probability that
// the ray has no return, computed from the two blended logits (docs/method.md M6). One
// thread per ray. Input: rendered, targets. Output: upstream. Accumulated: terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
RELIDAR_PARAMS(ImageLossParams);

/// Computes the L1 loss of the depth and adds its derivative to the gradient. With
/// normalised_depth, the blended depth is divided by the sum of the blending weights.
/// @return value of this loss term
float depth_loss(RenderedRay ray, float range_m, inout RayGradient gradient) {
    // The limit avoids a division by zero for rays that hit almost nothing.
    float weight = max(ray.weight, 1e-3);
    float scale = params.normalised_depth != 0u ? 1.0 / weight : 1.0;
    float error = ray.depth * scale - range_m;
    float d_error = params.depth_weight * sign(error);
    gradient.depth += d_error * scale;
    if (params.normalised_depth != 0u && ray.weight > 1e-3)
        gradient.weight -= d_error * ray.depth * scale * scale;
    return params.depth_weight * abs(error);
}

/// Computes the Huber loss of an intensity error e. The loss is e^2 / (2 delta) for |e| <
/// delta, otherwise |e| - delta / 2. If delta is 0, this is the L1 loss.
/// @return value of this loss term
float intensity_loss(float error, inout RayGradient gradient) {
    float delta = params.intensity_delta, size = abs(error);
    bool squared = size < delta;
    gradient.intensity += params.intensity_weight * (squared ? error / delta : sign(error));
    return params.intensity_weight * (squared ? 0.5 * error * error / delta : size - 0.5 * delta);
}

/// Computes the negative log probability of the measured outcome (return or no return).
/// Evaluates log(1 + exp(x)) without overflow.
/// @return value of this loss term
float drop_loss(RenderedRay ray, bool dropped, inout RayGradient gradient) {
    float x = ray.drop_logit - ray.hit_logit;
    float probability = 1.0 / (1.0 + exp(-x));
    float d_x = params.drop_weight * (probability - (dropped ? 1.0 : 0.0));
    gradient.drop_logit += d_x;
    gradient.hit_logit -= d_x;
    float z = dropped ? -x : x;
    return params.drop_weight * (max(z, 0.0) + log(1.0 + exp(-abs(z))));
}

/// Computes the loss terms of one ray with a known measurement (depth, intensity, ray
/// drop, opacity) and adds their derivatives to `gradient`.
vec4 loss_terms(RenderedRay ray, DeviceTarget target, inout RayGradient gradient) {
    vec4 terms = vec4(0.0);
    bool dropped = !(target.range_m > 0.0);
    if (!dropped) {
        terms.x = depth_loss(ray, target.range_m, gradient);
        terms.y = intensity_loss(ray.intensity - target.intensity, gradient);
        float missing = 1.0 - ray.weight;
        gradient.weight -= 2.0 * params.opacity_weight * missing;
        terms.w = params.opacity_weight * missing * missing;
    }
    terms.z = drop_loss(ray, dropped, gradient);
    return terms;
}

void main() {
    uint i = thread_index();
    vec4 terms = vec4(0.0);
    if (i < params.n_rays) {
        DeviceTarget target = params.targets.at[params.first_ray + i * params.ray_stride];
        // Rays without a known measurement keep zero gradients.
        RayGradient g;
#define RELIDAR_START(name, built, value, input, slope, meaning) g.name = 0.0;
        RELIDAR_BLENDED_VALUES(RELIDAR_START)
#undef RELIDAR_START
        if (target.weight > 0.0) terms = loss_terms(params.rendered.at[i], target, g);
        params.upstream.at[i] = g;
    }
    add_to_sum(params.terms, kTerm_depth, terms.x);
    add_to_sum(params.terms, kTerm_intensity, terms.y);
    add_to_sum(params.terms, kTerm_drop, terms.z);
    add_to_sum(params.terms, kTerm_opacity, terms.w);
}
