// SPDX-License-Identifier: Apache-2.0
// Computes the values of surfels that were split or shared. Kernel densify/move has
// written copies of the original to their rows before. One thread per surfel of the old
// order. Input: action, n_rows, starts. In place: surfels.
//
// Split: moves each half to a random point of the surfel, in its plane (3D Gaussians:
// along all three axes), and divides its scales by 1.6.
//
// Share among N ("3D Gaussian Splatting as Markov Chain Monte Carlo", NeurIPS 2024,
// adapted to surfels): the opacity becomes s' = 1 - (1 - s)^(1/N), so that N copies
// transmit as much as the original. The scales are multiplied by sqrt(s / sum_{i=1..N} (1
// - (1 - s')^i) / i), so that the blended copies have the same integral over the plane.
// The paper sums over one axis with 1 / sqrt(k + 1). Here the factor is 1 / (k + 1), the
// area of a Gaussian to the power k + 1 relative to the surfel. The inner alternating sum
// has a closed form. 3D Gaussians use the same formula, because across a ray they are
// Gaussians over a plane with proportional scales.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../base/random.glsl"
#include "../shared/densify.h"
#include "../../scene/gaussian/quaternion.glsl"
RELIDAR_PARAMS(SpawnParams);

bool has_third_scale() { return !is_null(params.surfels.log_scale_w); }

void add_to_scales(uint row, float amount) {
    for (uint k = 0u; k < 2u; ++k) params.surfels.log_scale.at[2 * row + k] += amount;
    if (has_third_scale()) params.surfels.log_scale_w.at[row] += amount;
}

void split(uint row) {
    vec4 q;
    for (uint k = 0u; k < 4u; ++k) q[k] = params.surfels.rotation.at[4 * row + k];
    mat3 r = rotation_matrix(q);
    vec2 z = random_normal2(params.key, row, 2u);  // classify.comp uses the draws 0 and 1
    vec3 offset = z.x * exp(params.surfels.log_scale.at[2 * row]) * r[0] +
                  z.y * exp(params.surfels.log_scale.at[2 * row + 1]) * r[1];
    if (has_third_scale())
        offset += random_normal2(params.key, row, 3u).x * exp(params.surfels.log_scale_w.at[row]) * r[2];
    for (uint k = 0u; k < 3u; ++k) params.surfels.mean.at[3 * row + k] += offset[k];
    add_to_scales(row, -log(1.6));
}

void share(uint row, uint n) {
    float logit = params.surfels.opacity_logit.at[row];
    float log_through = -max(logit, 0.0) - log(1.0 + exp(-abs(logit)));  // ln(1 - s)
    float step_log = log_through / float(n);                             // ln(1 - s')
    float sum = 0.0;
    for (uint i = 1u; i <= n; ++i) sum += (1.0 - exp(float(i) * step_log)) / float(i);
    float log_factor = 0.5 * log((1.0 - exp(log_through)) / sum);
    float shared_logit =
        max(log(1.0 - exp(step_log)) - step_log, log(params.min_opacity / (1.0 - params.min_opacity)));
    params.surfels.opacity_logit.at[row] = shared_logit;
    add_to_scales(row, log_factor);
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint action = params.action.at[i];
    if (action != RELIDAR_DENSIFY_SPLIT && action != RELIDAR_DENSIFY_SHARE) return;
    uint n = params.n_rows.at[i];
    for (uint k = 0u; k < n; ++k) {
        uint row = params.starts.at[i] + k;
        if (action == RELIDAR_DENSIFY_SPLIT) split(row);
        else share(row, n);
    }
}
