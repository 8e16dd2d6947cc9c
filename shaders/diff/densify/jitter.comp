// SPDX-License-Identifier: Apache-2.0
// Adds the exploration noise of the Monte Carlo strategy to the means. Moves each mean in
// its surfel's plane (3D Gaussians: along all axes), in units of the surfel's scales. A
// gate limits the noise to faint surfels ("3D Gaussian Splatting as Markov Chain Monte
// Carlo": sigmoid(-100 (s - faint)), there with faint = 0.005). One thread per surfel. In
// place: surfels.mean.
// @differs The paper's noise is the covariance (m^2) times a constant that depends on the
// length unit of its scenes. Here the noise is relative to the scales.
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
