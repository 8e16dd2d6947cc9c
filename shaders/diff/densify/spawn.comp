// SPDX-License-Identifier: Apache-2.0
// Computes the values of split surfels. Their new rows already contain copies of the
// original values, which kernel densify/move has written. Moves each half to a random
// point of the original surfel and divides its scales by 1.6. One thread per surfel of
// the old order. Input: action, n_rows, starts. In place: surfels.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../base/random.glsl"
#include "../shared/densify.h"
#include "../../scene/gaussian/quaternion.glsl"
RELIDAR_PARAMS(SpawnParams);

bool has_third_axis() { return !is_null(params.surfels.log_scale_w); }

void add_log_scales(uint row, float amount) {
    for (uint k = 0u; k < 2u; ++k) params.surfels.log_scale.at[2 * row + k] += amount;
    if (has_third_axis()) params.surfels.log_scale_w.at[row] += amount;
}

void split_surfel(uint row) {
    vec4 q;
    for (uint k = 0u; k < 4u; ++k) q[k] = params.surfels.rotation.at[4 * row + k];
    mat3 r = rotation_matrix(q);
    // Starts with random number 2, because kernel densify/classify has used 0 and 1.
    vec2 z = normal_pair(params.key, row, 2u);
    // A random point of the surfel's Gaussian, relative to its mean.
    vec3 offset = z.x * exp(params.surfels.log_scale.at[2 * row]) * r[0] +
                  z.y * exp(params.surfels.log_scale.at[2 * row + 1]) * r[1];
    if (has_third_axis())
        offset += normal_pair(params.key, row, 3u).x * exp(params.surfels.log_scale_w.at[row]) * r[2];
    for (uint k = 0u; k < 3u; ++k) params.surfels.mean.at[3 * row + k] += offset[k];
    add_log_scales(row, -log(1.6));
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    if (params.action.at[i] != RELIDAR_DENSIFY_SPLIT) return;
    for (uint k = 0u; k < params.n_rows.at[i]; ++k) split_surfel(params.starts.at[i] + k);
}
