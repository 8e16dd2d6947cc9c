// SPDX-License-Identifier: Apache-2.0
// Computes the loss -ln(floor + (1 - floor) S) of each ray with a return (docs/method.md
// M12). S is the likelihood of the measured range given the hits of the ray. One thread
// per ray. Input: rendered, targets. Accumulated: upstream, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/likelihood_loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
RELIDAR_PARAMS(LikelihoodLossParams);

/// Returns the loss of one ray with a measured return, and adds its derivative to the
/// gradient of the ray.
float likelihood_loss(uint ray) {
    float explained =
        params.likelihood_floor + (1.0 - params.likelihood_floor) * params.rendered.at[ray].likelihood;
    params.upstream.at[ray].likelihood += -params.weight * (1.0 - params.likelihood_floor) / explained;
    return -params.weight * log(explained);
}

void main() {
    uint i = thread_index();
    float term = 0.0;
    if (i < params.n_rays) {
        DeviceTarget target = params.targets.at[params.first_ray + i * params.ray_stride];
        if (target.weight > 0.0 && target.range_m > 0.0) term = likelihood_loss(i);
    }
    add_to_sum(params.terms, kTerm_likelihood, term);
}
