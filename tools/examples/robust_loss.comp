// SPDX-License-Identifier: Apache-2.0
// Computes the loss log(1 + (e / scale)^2) of each ray with a return, and its
// derivatives. e = D / W - z is the rendered minus the measured range. D is a weighted
// sum of ranges over surfels, and W is the sum of the weights. One thread per ray. Input:
// rendered, targets. Accumulated: upstream, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "relidar/base/reduce.glsl"
#include "robust_loss.h"
RELIDAR_PARAMS(RobustLossParams);

float robust_loss(uint ray, float range_m) {
    RenderedRay r = params.rendered.at[ray];
    if (r.weight < 0.1) return 0.0;  // the ray hits almost nothing
    float error = (r.depth / r.weight - range_m) / params.scale_m, square = error * error;
    float d_range = params.weight * 2.0 * error / (1.0 + square) / params.scale_m;
    params.upstream.at[ray].depth += d_range / r.weight;
    params.upstream.at[ray].weight -= d_range * r.depth / (r.weight * r.weight);
    return params.weight * log(1.0 + square);
}

void main() {
    uint i = thread_index();
    float loss = 0.0;
    if (i < params.n_rays) {
        DeviceTarget target = params.targets.at[params.first_ray + i * params.ray_stride];
        if (target.weight > 0.0 && target.range_m > 0.0) loss = robust_loss(i, target.range_m);
    }
    add_to_sum(params.terms, RELIDAR_CUSTOM_TERM, loss);
}
