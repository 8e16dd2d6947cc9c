// SPDX-License-Identifier: Apache-2.0
// Computes the gradient of one hit with respect to its surfel's record, its channel
// values and the ray in the model frame. Two backward kernels use this file: one adds
// gradients with atomics, the other adds them in a fixed order.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_HIT_GRADIENT_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_HIT_GRADIENT_GLSL

#include "../traversal/likelihood.glsl"

/// Gradient of one hit with respect to the 16 floats of its surfel and to the ray, both
/// in the model frame.
struct HitGradient {
    float lanes[16];
    // Gradient of the hit's intensity and of its two logits of the ray-drop probability.
    vec3 d_channel;
    vec3 d_origin;
    vec3 d_direction;
};

/// The spherical harmonics (SH) of a surfel depend on the ray direction. Returns their
/// contribution to the gradient of the direction, in the model frame.
vec3 direction_gradient(TraceScene scene, vec3 direction, uint surfel, vec3 d_channel) {
    float d_basis[16];
    for (uint k = 0u; k < 16u; ++k) d_basis[k] = 0.0;
    uint first = surfel * RELIDAR_SH_FLOATS;
    for (uint c = 0u; c < 3u; ++c)
        for (uint k = 0u; k < count_sh(scene.sh_degree); ++k)
            d_basis[k] += d_channel[c] * scene.sh.at[first + c * RELIDAR_SH_COEFFICIENTS + k];
    return sh_basis_vjp(direction, scene.sh_degree, d_basis);
}

/// Computes the gradient of a hit.
/// @param gradient gradients of the ray's blended values
/// @param weight blending weight of the hit
/// @param d_alpha derivative of the loss with respect to alpha. 0 if alpha was clamped
HitGradient hit_vjp(TraceScene scene, Ray ray, RayGradient gradient, uint instance, uint surfel, float weight,
                    float d_alpha) {
    SurfelRecord record = scene.records.at[surfel];
    enter_instance(scene, ray, instance);
    vec3 origin = entered_origin, direction = entered_direction;
    SurfelHit hit;
    intersect(record, origin, direction, hit);
    float d_t = 0.0, nowhere = 0.0;
    vec3 d_channel = vec3(0.0);
#define RELIDAR_SEND(name, built, value, input, slope, meaning) \
    if (built) input += gradient.name * weight * (slope);
    RELIDAR_BLENDED_VALUES(RELIDAR_SEND)
#undef RELIDAR_SEND
    if (SINGLE_DROP_LOGIT != 0u) d_channel.y = 0.0;
    SurfelHitGradient d = intersect_vjp(record, origin, direction, hit, d_t, d_alpha);
    // Stored in elements 7, 11 and 15 of `lanes` below. If spherical harmonics (SH) are
    // evaluated per surfel: gradient of the hit's intensity and two ray-drop logits. If
    // SH are evaluated per hit: gradient of a small rotation of the ray direction.
    vec3 others = d_channel;
    if (SH_PER_SURFEL == 0u) {
        cache_sh_basis(scene, ray, instance);
        // The forward pass clamps negative intensities to 0, so their gradient is 0.
        if (!(channel_value(scene, surfel, 0u) > 0.0)) d_channel.x = 0.0;
        vec3 d_sh_direction = direction_gradient(scene, direction, surfel, d_channel);
        d.d_direction += d_sh_direction;
        others = cross(direction, d_sh_direction);
    }
    float lanes[16] = float[](d.d_mean.x, d.d_mean.y, d.d_mean.z, d.d_opacity, d.d_axis_u.x, d.d_axis_u.y,
                              d.d_axis_u.z, others.x, d.d_axis_v.x, d.d_axis_v.y, d.d_axis_v.z, others.y,
                              d.d_normal.x, d.d_normal.y, d.d_normal.z, others.z);
    return HitGradient(lanes, d_channel, d.d_origin, d.d_direction);
}
#endif
