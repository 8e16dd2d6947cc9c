// SPDX-License-Identifier: Apache-2.0
// Computes the record of each surfel from its parameters (docs/method.md section 2).
// Normalises the rotation, applies exp to the scales and applies the sigmoid function to
// the opacity. On actors with a periodic motion (gait), mean and opacity also depend on
// the phase of the motion.
//
// If spherical harmonics (SH) are evaluated per surfel, computes the channel values in
// the direction from the view origin to the mean. A surfel gets opacity 0 and is never
// hit if a value is not finite or if it is too faint to be visible.
//
// One thread per surfel of any model. Input: surfels, models, view_origins, phases.
// Output: records.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "find_model.glsl"
#include "shared/scene.h"
#include "gaussian/quaternion.glsl"
#include "gaussian/sh.glsl"
#include "gaussian/gait.glsl"
#include "sh_rows.glsl"
RELIDAR_PARAMS(ActivateParams);

/// Evaluates the spherical harmonics (intensity and logits) of a surfel in a direction.
/// Every thread of the workgroup must call this function.
/// @return false if an active coefficient is NaN or infinite. The values may hide a NaN,
/// because max(NaN, 0) is 0
bool evaluate_channels(uint surfel, bool has_surfel, vec3 direction, out vec3 channels) {
    float basis[16];
    sh_basis(direction, params.sh_degree, basis);
    uint n = count_sh(params.sh_degree);
    float size = 0.0;
    set_sh_access(has_surfel, false);
    for (uint c = 0u; c < 3u; ++c) {
        load_sh_channel(params.surfels.sh, surfel, c, n);
        float value = 0.5;
        for (uint k = 0u; k < n; ++k) {
            float x = load_sh_value(params.surfels.sh, surfel, c, k);
            value += basis[k] * x;
            size += abs(x);
        }
        channels[c] = value;
    }
    return !isnan(size) && !isinf(size);
}

bool is_finite(vec3 vector) { return !any(isnan(vector)) && !any(isinf(vector)); }

void main() {
    uint i = thread_index();
    bool has_surfel = i < params.n_surfels;
    // If STAGED is set, threads without a surfel continue, because they help to load
    // coefficients into shared memory.
    if (!STAGED && !has_surfel) return;
    uint surfel = has_surfel ? i : 0u;
    Floats mean = params.surfels.mean, rotation = params.surfels.rotation,
           log_scale = params.surfels.log_scale;
    uint model = find_model(params.models, params.n_models, surfel);
    PeriodicMotion motion = evaluate_gait(params.surfels.gait, surfel,
                                          is_null(params.surfels.gait) ? -1.0 : params.phases.at[model]);
    SurfelRecord s;
    s.mean = vec3(mean.at[3 * surfel], mean.at[3 * surfel + 1], mean.at[3 * surfel + 2]) +
             motion.sine * motion.swing;
    vec4 q = vec4(rotation.at[4 * surfel], rotation.at[4 * surfel + 1], rotation.at[4 * surfel + 2],
                  rotation.at[4 * surfel + 3]);
    // Rejects quaternions whose squared length is outside 1e-30 ... 1e30. Their rotation
    // matrix would be wrong because of underflow or overflow.
    float q_length2 = dot(q, q);
    mat3 r = rotation_matrix(q);
    s.axis_u = r[0] * exp(-log_scale.at[2 * surfel]);
    s.axis_v = r[1] * exp(-log_scale.at[2 * surfel + 1]);
    s.normal = r[2];
    // For a 3D Gaussian, `normal` is its third axis divided by the standard deviation.
    if (!is_null(params.surfels.log_scale_w)) s.normal *= exp(-params.surfels.log_scale_w.at[surfel]);
    s.opacity = motion.presence / (1.0 + exp(-params.surfels.opacity_logit.at[surfel]));
    vec3 channels;
    bool finite_sh =
        evaluate_channels(i, has_surfel, normalize(s.mean - params.view_origins.at[model]), channels);
    bool evaluate = params.sh_per_surfel != 0u;
    s.intensity = evaluate ? max(channels.x, 0.0) : 0.0;
    s.hit_logit = evaluate ? channels.y : 0.0;
    s.drop_logit = evaluate ? channels.z : 0.0;
    // A surfel is invisible if a scale is outside 1e-6 m ... 1e6 m.
    vec3 inverse_scale = vec3(length(s.axis_u), length(s.axis_v), length(s.normal));
    bool finite = q_length2 > 1e-30 && q_length2 < 1e30 && all(greaterThan(inverse_scale, vec3(1e-6))) &&
                  all(lessThan(inverse_scale, vec3(1e6))) && is_finite(s.mean) && is_finite(s.axis_u) &&
                  is_finite(s.axis_v) && is_finite(s.normal) && finite_sh;
    if (!finite || !(s.opacity > params.alpha_min)) {
        bool placed = is_finite(s.mean);
        s = SurfelRecord(placed ? s.mean : vec3(0.0), 0.0, vec3(1.0, 0.0, 0.0), 0.0, vec3(0.0, 1.0, 0.0), 0.0,
                         vec3(0.0, 0.0, 1.0), 0.0);
    }
    if (has_surfel) params.records.at[surfel] = s;
}
