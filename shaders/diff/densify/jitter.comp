// SPDX-License-Identifier: Apache-2.0
// Exploration of the Monte Carlo strategy: means move at random in their surfel's plane
// (3D Gaussians: along all axes), by scales of the surfel, and only those of faint
// surfels, which have nothing to lose (gate of "3D Gaussian Splatting as Markov Chain
// Monte Carlo": sigmoid(-100 (s - faint)), faint = 0.005 there). One thread a surfel. In
// place: surfels.mean.
// @differs the paper's noise is the covariance (m^2) times a number that only suits the
// length unit of its scenes; here it is in scales.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../base/random.glsl"
#include "../shared/densify.h"
#include "../../scene/gaussian/quaternion.glsl"
RELIDAR_PARAMS(JitterParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    float opacity = 1.0 / (1.0 + exp(-params.surfels.opacity_logit.at[i]));
    float gate = 1.0 / (1.0 + exp(100.0 * (opacity - params.faint_opacity)));
    vec4 q;
    for (uint k = 0u; k < 4u; ++k) q[k] = params.surfels.rotation.at[4 * i + k];
    mat3 r = rotation_matrix(q);
    vec2 z = params.amount * gate * random_normal2(params.key, i, 0u);
    vec3 offset = z.x * exp(params.surfels.log_scale.at[2 * i]) * r[0] +
                  z.y * exp(params.surfels.log_scale.at[2 * i + 1]) * r[1];
    if (!is_null(params.surfels.log_scale_w))
        offset += params.amount * gate * random_normal2(params.key, i, 1u).x *
                  exp(params.surfels.log_scale_w.at[i]) * r[2];
    for (uint k = 0u; k < 3u; ++k) params.surfels.mean.at[3 * i + k] += offset[k];
}
