// SPDX-License-Identifier: Apache-2.0
// Blends the hits of a ray from near to far (paper, Eq. 2-4), which gives the values in
// relidar/diff/blended_values.h. For scans, also computes the blended normal and the
// surface with the largest weight. Include this file after RELIDAR_PARAMS(ForwardParams).
#ifndef RELIDAR_INCLUDED_DIFF_FORWARD_BLEND_GLSL
#define RELIDAR_INCLUDED_DIFF_FORWARD_BLEND_GLSL

struct Blended {
    RenderedRay ray;
    RayGradient lost;  // rounding error of each blended value, for compensated summation
    vec3 normal;
    Surfaces surfaces;
};

/// Returns the state of a ray before its first hit: all sums 0, transmittance 1.
Blended start_blending(TraceScene scene, uint ray_index) {
    Blended b;
#define RELIDAR_START(name, built, value, input, slope, meaning) b.ray.name = b.lost.name = 0.0;
    RELIDAR_BLENDED_VALUES(RELIDAR_START)
#undef RELIDAR_START
    b.ray.transmittance = 1.0;
    b.ray.median_depth = 0.0;
    b.ray.n_hits = 0u;
    b.ray.instance = RELIDAR_NO_INSTANCE;
    b.normal = vec3(0.0);
    b.surfaces = empty_surfaces();
    if (LIKELIHOOD != 0u) cache_range(scene, ray_index);
    ray_basis_instance = kNoInstance;
    return b;
}

vec3 hit_channels(TraceScene scene, Ray ray, Hit hit) {
    return shade_hit(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
}

float transmittance_behind(TraceScene scene, Hit hit, float transmittance_before) {
    return transmittance_before * (1.0 - min(hit.alpha, scene.alpha_max));
}

/// Returns true if a hit reduces the transmittance below the limit. The ray then ends
/// before this hit, and the hit is not blended.
bool is_blocked(TraceScene scene, Hit hit, float transmittance_before) {
    return transmittance_behind(scene, hit, transmittance_before) < scene.transmittance_min;
}

/// Adds the next hit of the ray to the blended values. The hit at which the transmittance
/// falls to 0.5 gives the median depth and the instance. Until then, the instance is the
/// one of the first hit.
void blend_hit(TraceScene scene, Ray ray, Hit hit, vec3 channels, inout Blended blended) {
    float next = transmittance_behind(scene, hit, blended.ray.transmittance),
          w = min(hit.alpha, scene.alpha_max) * blended.ray.transmittance;
    if (NORMAL != 0u) blended.normal += w * facing_normal(scene, ray, hit.instance, hit.surfel);
    if (MODE != 0u) add_to_surfaces(hit.t, w, params.surface_gap_m, blended.surfaces);  // docs/method.md, M13
#define RELIDAR_BLEND(name, built, value, input, slope, meaning) \
    if (built) kahan_add(blended.ray.name, blended.lost.name, w*(value));
    RELIDAR_BLENDED_VALUES(RELIDAR_BLEND)
#undef RELIDAR_BLEND
    bool crosses = blended.ray.transmittance > 0.5 && next <= 0.5;
    if (crosses) blended.ray.median_depth = hit.t;
    if (crosses || blended.ray.n_hits == 0u) blended.ray.instance = hit.instance;
    blended.ray.transmittance = next;
    ++blended.ray.n_hits;
}

/// @param blend_index number of the hit in the order of blending
void store_hit(uint blend_index, Hit hit) {
    if (blend_index < params.n_kept)
        params.kept.at[hit_list_index(params.n_kept, thread_index(), blend_index)] = hit;
}

/// Adds the background to the blended values and writes the result of the ray.
void finish_blending(uint ray_index, inout Blended blended) {
    if (params.n_kept > 0u && blended.ray.n_hits > params.n_kept) atomicAdd(params.n_overfull.at[0], 1u);
    // Blends the background like a hit with the drop logit 1 and all other values 0. Its
    // weight is the remaining transmittance of the ray.
    kahan_add(blended.ray.drop_logit, blended.lost.drop_logit, blended.ray.transmittance);
    keep_heaviest(blended.surfaces);
    if (NORMAL != 0u || MODE != 0u)
        params.surfaces.at[ray_index] = RenderedSurface(blended.normal, blended.surfaces.heaviest_t);
    params.rendered.at[ray_index] = blended.ray;
}
#endif
