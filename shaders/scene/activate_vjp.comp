// SPDX-License-Identifier: Apache-2.0
// Parameter gradients from record gradients: the chain rule of activate.comp, once a frame instead of once a hit (docs/method.md
// section 4, reduction a). One thread a surfel.
// Input: surfels, d_records, more_rows. Output: d_surfels (sh only where SH are evaluated a surfel), touched, d_view.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/scene.h"
#include "../gaussian/quaternion.glsl"
#include "../gaussian/sh.glsl"
RELIDAR_PARAMS(ActivateVjpParams);

/// Gradient of the SH coefficients of one surfel; returns dL/d(direction).
vec3 channels_vjp(uint surfel, vec3 direction, vec3 d_channel) {
    float basis[16], d_basis[16];
    uint n = sh_count(params.sh_degree);
    sh_basis(direction, params.sh_degree, basis);
    for (uint k = 0u; k < 16u; ++k) d_basis[k] = 0.0;
    Floats sh = params.surfels.sh;
    uint first = surfel * RELIDAR_SH_FLOATS;
    float intensity = 0.5;
    for (uint k = 0u; k < n; ++k) intensity += basis[k] * sh.at[first + k];
    if (intensity < 0.0) d_channel.x = 0.0;   // clamped at 0 in the record
    for (uint c = 0u; c < 3u; ++c)
        for (uint k = 0u; k < n; ++k) {
            params.d_surfels.sh.at[first + c * 16u + k] = d_channel[c] * basis[k];
            d_basis[k] += d_channel[c] * sh.at[first + c * 16u + k];
        }
    return sh_basis_vjp(direction, params.sh_degree, d_basis);
}

vec3 load3(Floats a, uint i) { return vec3(a.at[i], a.at[i + 1], a.at[i + 2]); }

void store_view(uint surfel, vec3 g) {
    if (is_null(params.d_view)) return;
    for (uint k = 0u; k < 3u; ++k) params.d_view.at[3 * surfel + k] = g[k];
}

/// Record gradient of a surfel, summed over the placements of its model. @return whether it is not zero
bool load_row(uint i, out float row[16]) {
    bool any_gradient = false;
    for (uint k = 0u; k < 16u; ++k) {
        row[k] = params.d_records.at[16u * (params.first_surfel + i) + k];
        for (uint p = 0u; p < params.n_more; ++p) row[k] += params.d_records.at[16u * (params.more_rows.at[p] + i) + k];
        any_gradient = any_gradient || row[k] != 0.0;
    }
    return any_gradient;
}

bool is_gaussian() { return !is_null(params.surfels.log_scale_w); }

void store_zero(uint surfel) {
    for (uint k = 0u; k < 3u; ++k) params.d_surfels.mean.at[3 * surfel + k] = 0.0;
    for (uint k = 0u; k < 4u; ++k) params.d_surfels.rotation.at[4 * surfel + k] = 0.0;
    for (uint k = 0u; k < 2u; ++k) params.d_surfels.log_scale.at[2 * surfel + k] = 0.0;
    if (is_gaussian()) params.d_surfels.log_scale_w.at[surfel] = 0.0;
    params.d_surfels.opacity_logit.at[surfel] = 0.0;
    if (params.sh_per_surfel == 0u) return;
    for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k) params.d_surfels.sh.at[surfel * RELIDAR_SH_FLOATS + k] = 0.0;
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint surfel = params.first_surfel + i;
    float row[16];
    bool any_gradient = load_row(i, row);
    params.touched.at[surfel] = any_gradient ? 1u : 0u;
    if (!any_gradient) {
        if (params.zero_untouched != 0u) store_zero(surfel);
        store_view(surfel, vec3(0.0));
        return;
    }

    vec3 d_mean = vec3(row[0], row[1], row[2]);
    float d_opacity = row[3];
    vec3 d_axis_u = vec3(row[4], row[5], row[6]);
    vec3 d_axis_v = vec3(row[8], row[9], row[10]);
    vec3 d_normal = vec3(row[12], row[13], row[14]);
    vec3 d_channel = vec3(row[7], row[11], row[15]);

    vec4 q = vec4(params.surfels.rotation.at[4 * surfel], params.surfels.rotation.at[4 * surfel + 1],
                  params.surfels.rotation.at[4 * surfel + 2], params.surfels.rotation.at[4 * surfel + 3]);
    mat3 r = rotation_matrix(q);
    vec3 inverse_scale = exp(-vec3(params.surfels.log_scale.at[2 * surfel], params.surfels.log_scale.at[2 * surfel + 1], is_gaussian() ? params.surfels.log_scale_w.at[surfel] : 0.0));
    vec4 d_q = rotation_matrix_vjp(q, mat3(d_axis_u * inverse_scale.x, d_axis_v * inverse_scale.y, d_normal * inverse_scale.z));
    float opacity = 1.0 / (1.0 + exp(-params.surfels.opacity_logit.at[surfel]));

    if (params.sh_per_surfel != 0u) {
        vec3 to_mean = load3(params.surfels.mean, 3 * surfel) - params.view_origin;
        float inverse_length = inversesqrt(dot(to_mean, to_mean));
        vec3 direction = to_mean * inverse_length;
        vec3 d_direction = channels_vjp(surfel, direction, d_channel);
        vec3 d_to_mean = (d_direction - direction * dot(direction, d_direction)) * inverse_length;
        d_mean += d_to_mean;
        store_view(surfel, -d_to_mean);
    }
    for (uint k = 0u; k < 3u; ++k) params.d_surfels.mean.at[3 * surfel + k] = d_mean[k];
    for (uint k = 0u; k < 4u; ++k) params.d_surfels.rotation.at[4 * surfel + k] = d_q[k];
    params.d_surfels.log_scale.at[2 * surfel] = -dot(d_axis_u, r[0]) * inverse_scale.x;   // axis_u = a_u exp(-log_scale)
    params.d_surfels.log_scale.at[2 * surfel + 1] = -dot(d_axis_v, r[1]) * inverse_scale.y;
    if (is_gaussian()) params.d_surfels.log_scale_w.at[surfel] = -dot(d_normal, r[2]) * inverse_scale.z;
    params.d_surfels.opacity_logit.at[surfel] = d_opacity * opacity * (1.0 - opacity);
}
