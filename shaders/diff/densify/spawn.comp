// SPDX-License-Identifier: Apache-2.0
// Values of surfels that were split or shared, where densify/move has put copies of the
// original. One thread a surfel of the old order. Input: action, n_rows, starts. In
// place: surfels. Split: each half at a random point of the surfel, in its plane, scales
// / 1.6; of a 3D Gaussian along all three axes. Share among N ("3D Gaussian Splatting as
// Markov Chain Monte Carlo", NeurIPS 2024, for surfels): opacity s' = 1 - (1 - s)^(1/N),
// so that N of them let through what one did; and scales times sqrt(s / sum_{i=1..N} (1 -
// (1 - s')^i) / i), so that what they blend to has the integral over the plane that the
// one had: the paper's sums over one axis, with 1 / (k + 1) for its 1 / sqrt(k + 1)
// because a Gaussian to the power k + 1 has that share of the area of a surfel. The inner
// alternating sum is closed here. 3D Gaussians are shared alike: across a ray, from
// wherever it comes, they are Gaussians over a plane whose scales go with theirs.
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
    vec2 z = random_normal2(params.key, row, 2u);  // 0 and 1 are classify's
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
