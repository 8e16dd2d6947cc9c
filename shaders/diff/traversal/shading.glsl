// SPDX-License-Identifier: Apache-2.0
// Computes the channel values of a hit: intensity, hit logit and drop logit. If spherical
// harmonics (SH) are evaluated per surfel, the record contains the values. Otherwise the
// SH are evaluated here, in the direction of the ray in the model's frame (docs/method.md
// section 3).
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHADING_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHADING_GLSL
RELIDAR_CONSTANT(uint, SH_PER_SURFEL, 1u);
RELIDAR_CONSTANT(uint, SINGLE_DROP_LOGIT, 0u);

const uint kNoInstance = 0xffffffffu;
// Spherical-harmonic basis functions for the direction of the current ray, in the frame
// of instance ray_basis_instance.
float ray_basis[16];
uint ray_basis_instance;

/// Computes the spherical-harmonic (SH) basis for the ray in the frame of an instance.
/// Does nothing if SH are evaluated once per surfel.
void cache_sh_basis(TraceScene scene, Ray ray, uint instance) {
    if (SH_PER_SURFEL != 0u || ray_basis_instance == instance) return;
    enter_instance(scene, ray, instance);
    sh_basis(entered_direction, scene.sh_degree, ray_basis);
    ray_basis_instance = instance;
}

float channel_value(TraceScene scene, uint surfel, uint channel) {
    float value = 0.5;
    uint first = surfel * RELIDAR_SH_FLOATS + channel * RELIDAR_SH_COEFFICIENTS;
    for (uint k = 0u; k < count_sh(scene.sh_degree); ++k) value += ray_basis[k] * scene.sh.at[first + k];
    return value;
}

/// Evaluates the spherical harmonics of the intensity and of the two logits of the
/// ray-drop probability, in one loop.
vec3 evaluate_channels(TraceScene scene, uint surfel) {
    vec3 value = vec3(0.5);
    uint x = surfel * RELIDAR_SH_FLOATS, y = x + RELIDAR_SH_COEFFICIENTS, z = y + RELIDAR_SH_COEFFICIENTS;
    for (uint k = 0u; k < count_sh(scene.sh_degree); ++k) {
        float hit_logit = SINGLE_DROP_LOGIT != 0u ? 0.0 : scene.sh.at[y + k];
        value += ray_basis[k] * vec3(scene.sh.at[x + k], hit_logit, scene.sh.at[z + k]);
    }
    return value;
}

/// Returns a hit's intensity (at least 0), logit of a return, logit of a dropped return.
vec3 shade_hit(TraceScene scene, Ray ray, uint instance, uint surfel, SurfelRecord record) {
    if (SH_PER_SURFEL != 0u)
        return vec3(record.intensity, SINGLE_DROP_LOGIT != 0u ? 0.0 : record.hit_logit, record.drop_logit);
    cache_sh_basis(scene, ray, instance);
    vec3 value = evaluate_channels(scene, surfel);
    return vec3(max(value.x, 0.0), SINGLE_DROP_LOGIT != 0u ? 0.0 : value.y, value.z);
}
#endif
