// SPDX-License-Identifier: Apache-2.0
// Computes parameter gradients from record gradients. This is the chain rule of
// activate.comp, applied once per frame instead of once per hit (docs/method.md section
// 4, reduction a).
//
// One thread per surfel of any model. On CPUs, the kernel processes only surfels in a
// list (list_touched.comp), because lanes without a gradient take as long as lanes with a
// gradient.
//
// Input: surfels, d_records, models, more_rows, view_origins, phases, rows, n_listed.
// Output: d_surfels (sh only if SH are evaluated per surfel), touched, d_view.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "find_model.glsl"
#include "shared/scene.h"
#include "gaussian/quaternion.glsl"
#include "gaussian/sh.glsl"
#include "gaussian/gait.glsl"
#include "sh_rows.glsl"
RELIDAR_PARAMS(ActivateVjpParams);

/// Computes the gradient of a surfel's spherical-harmonic coefficients. It is zero if
/// `has_gradient` is false. Every thread of the workgroup must call this function.
/// @return dL/d(direction)
vec3 channels_vjp(uint surfel, bool has_gradient, vec3 direction, vec3 d_channels) {
    float basis[16], d_basis[16];
    uint n = count_sh(params.sh_degree);
    sh_basis(direction, params.sh_degree, basis);
    for (uint k = 0u; k < 16u; ++k) d_basis[k] = 0.0;
    Floats sh = params.surfels.sh, d_sh = params.d_surfels.sh;
    for (uint c = 0u; c < 3u; ++c) {
        load_sh_channel(sh, surfel, c, n);
        float d = d_channels[c];
        if (c == 0u) {
            float intensity = 0.5;
            for (uint k = 0u; k < n; ++k) intensity += basis[k] * load_sh_value(sh, surfel, c, k);
            // The forward pass clamps negative intensities to 0, so their gradient is 0.
            if (intensity < 0.0) d = 0.0;
        }
        for (uint k = 0u; k < n; ++k) {
            d_basis[k] += d * load_sh_value(sh, surfel, c, k);
            set_coefficient(d_sh, surfel, c, k, has_gradient ? d * basis[k] : 0.0);
        }
        store_channel(d_sh, surfel, c, n);
    }
    return sh_basis_vjp(direction, params.sh_degree, d_basis);
}

vec3 load_vec3(Floats array, uint row) { return vec3(array.at[row], array.at[row + 1], array.at[row + 2]); }

void store_view_grad(uint surfel, vec3 gradient) {
    if (is_null(params.d_view)) return;
    for (uint k = 0u; k < 3u; ++k) params.d_view.at[3 * surfel + k] = gradient[k];
}

/// Loads the gradient of the 16 floats of a surfel's record (SurfelRecord), summed over
/// all instances of its model.
/// @return true if any component is not zero
bool load_gradient(uint surfel, ModelEntry model, out float d_record[16]) {
    for (uint k = 0u; k < 16u; ++k) d_record[k] = params.d_records.at[16u * surfel + k];
    for (uint p = 0u; p < model.n_more; ++p) {
        uint first = 16u * (params.more_rows.at[model.first_more + p] + surfel - model.first_surfel);
        for (uint k = 0u; k < 16u; ++k) d_record[k] += params.d_records.at[first + k];
    }
    bool has_gradient = false;
    for (uint k = 0u; k < 16u; ++k) has_gradient = has_gradient || d_record[k] != 0.0;
    return has_gradient;
}

bool has_third_axis() { return !is_null(params.surfels.log_scale_w); }
bool has_gait() { return !is_null(params.surfels.gait); }

void zero_gradients(uint surfel) {
    for (uint k = 0u; k < 3u; ++k) params.d_surfels.mean.at[3 * surfel + k] = 0.0;
    for (uint k = 0u; k < 4u; ++k) params.d_surfels.rotation.at[4 * surfel + k] = 0.0;
    for (uint k = 0u; k < 2u; ++k) params.d_surfels.log_scale.at[2 * surfel + k] = 0.0;
    if (has_third_axis()) params.d_surfels.log_scale_w.at[surfel] = 0.0;
    params.d_surfels.opacity_logit.at[surfel] = 0.0;
    if (has_gait())
        for (uint k = 0u; k < 5u; ++k) params.d_surfels.gait.at[5 * surfel + k] = 0.0;
    // If STAGED is set, channels_vjp() writes the zeros of the SH coefficients.
    if (STAGED || params.sh_per_surfel == 0u) return;
    for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k)
        params.d_surfels.sh.at[surfel * RELIDAR_SH_FLOATS + k] = 0.0;
}

/// Writes the gradients of all parameters of a surfel except its spherical-harmonic
/// coefficients.
/// @param d_mean gradient of the centre. Used instead of d_record[0..2], because it also
/// includes the effect of the viewing direction
/// @param d_record input: gradient of the 16 floats of the surfel's record (SurfelRecord)
void write_gradients(uint surfel, PeriodicMotion motion, vec3 d_mean, float d_record[16]) {
    vec3 d_axis_u = vec3(d_record[4], d_record[5], d_record[6]);
    vec3 d_axis_v = vec3(d_record[8], d_record[9], d_record[10]);
    vec3 d_normal = vec3(d_record[12], d_record[13], d_record[14]);
    vec4 q = vec4(params.surfels.rotation.at[4 * surfel], params.surfels.rotation.at[4 * surfel + 1],
                  params.surfels.rotation.at[4 * surfel + 2], params.surfels.rotation.at[4 * surfel + 3]);
    mat3 r = rotation_matrix(q);
    vec3 inverse_scale =
        exp(-vec3(params.surfels.log_scale.at[2 * surfel], params.surfels.log_scale.at[2 * surfel + 1],
                  has_third_axis() ? params.surfels.log_scale_w.at[surfel] : 0.0));
    vec4 d_q = rotation_vjp(
        q, mat3(d_axis_u * inverse_scale.x, d_axis_v * inverse_scale.y, d_normal * inverse_scale.z));
    float opacity = 1.0 / (1.0 + exp(-params.surfels.opacity_logit.at[surfel]));
    for (uint k = 0u; k < 3u; ++k) params.d_surfels.mean.at[3 * surfel + k] = d_mean[k];
    for (uint k = 0u; k < 4u; ++k) params.d_surfels.rotation.at[4 * surfel + k] = d_q[k];
    // from axis_u = a_u exp(-log_scale)
    params.d_surfels.log_scale.at[2 * surfel] = -dot(d_axis_u, r[0]) * inverse_scale.x;
    params.d_surfels.log_scale.at[2 * surfel + 1] = -dot(d_axis_v, r[1]) * inverse_scale.y;
    if (has_third_axis()) params.d_surfels.log_scale_w.at[surfel] = -dot(d_normal, r[2]) * inverse_scale.z;
    params.d_surfels.opacity_logit.at[surfel] = d_record[3] * motion.presence * opacity * (1.0 - opacity);
    if (!has_gait()) return;
    float d_parameters[5];
    gait_vjp(motion, d_mean, d_record[3] * opacity, d_parameters);
    for (uint k = 0u; k < 5u; ++k) params.d_surfels.gait.at[5 * surfel + k] = d_parameters[k];
}

/// Converts the gradient of a surfel's record, which tracing kernels read, to gradients
/// of its parameters, which the optimizer changes. If STAGED is set, threads share data,
/// so that all threads of the workgroup must call this function.
void record_vjp(uint surfel, bool has_surfel) {
    uint model = find_model(params.models, params.n_models, surfel);
    float d_record[16];
    bool has_gradient = has_surfel && load_gradient(surfel, params.models.at[model], d_record);
    if (has_surfel) params.touched.at[surfel] = has_gradient ? 1u : 0u;

    PeriodicMotion motion = evaluate_gait(params.surfels.gait, has_surfel ? surfel : 0u,
                                          has_gait() ? params.phases.at[model] : -1.0);
    vec3 d_to_mean = vec3(0.0);
    if (params.sh_per_surfel != 0u && (STAGED || has_gradient)) {
        vec3 mean =
            load_vec3(params.surfels.mean, 3 * (has_surfel ? surfel : 0u)) + motion.sine * motion.swing;
        vec3 to_mean = has_gradient ? mean - params.view_origins.at[model] : vec3(1.0);
        float inverse_length = inversesqrt(dot(to_mean, to_mean));
        vec3 direction = to_mean * inverse_length;
        set_sh_access(has_gradient, has_surfel && (has_gradient || params.zero_untouched != 0u));
        vec3 d_direction =
            channels_vjp(surfel, has_gradient, direction, vec3(d_record[7], d_record[11], d_record[15]));
        d_to_mean = (d_direction - direction * dot(direction, d_direction)) * inverse_length;
    }
    if (has_gradient) {
        write_gradients(surfel, motion, vec3(d_record[0], d_record[1], d_record[2]) + d_to_mean, d_record);
        store_view_grad(surfel, -d_to_mean);
    } else if (has_surfel) {
        if (params.zero_untouched != 0u) zero_gradients(surfel);
        store_view_grad(surfel, vec3(0.0));
    }
}

void main() {
    uint i = thread_index(), n = is_null(params.rows) ? params.n_surfels : params.n_listed.at[0];
    if (STAGED) {
        record_vjp(i, i < n);  // threads without a surfel copy data of other threads
        return;
    }
    if (i >= n) return;
    do {
        record_vjp(is_null(params.rows) ? i : params.rows.at[i], true);
        i += thread_count();
    } while (i < n);
}
