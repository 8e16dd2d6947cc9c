// SPDX-License-Identifier: Apache-2.0
// Blends the hits of a ray, nearest first (Eq. 2-4; M4, M5). With geometric losses, also
// computes the blended normal and the distortion (M10, M11) and the likelihood (M12). For
// range images, also computes the heaviest surface (M13). Include this file after
// RELIDAR_PARAMS(ForwardParams).
#ifndef RELIDAR_INCLUDED_DIFF_FORWARD_BLEND_GLSL
#define RELIDAR_INCLUDED_DIFF_FORWARD_BLEND_GLSL

/// State of a ray during blending.
struct Blended {
    RenderedRay ray;
    RenderedGeometry geometry;
    Surfaces surfaces;
    float lost[6];  // rounding errors of the sums, for compensated summation
    float first_t;  // distance of the first hit
};

/// Adds a hit to the geometry of its ray.
/// @param before  weight of the hits before it
/// @param beyond  distance of the hit behind the first hit, which keeps the precision of
/// M10's sums
void add_geometry(TraceScene scene, Ray ray, Hit hit, float w, float before, float beyond,
                  inout RenderedGeometry q) {
    q.distortion += w * (beyond * before - q.moment);  // M10
    q.moment += w * beyond;
    q.normal += w * facing_normal(scene, ray, hit.instance, hit.surfel);
}

/// Sets each field by name, so that a new field cannot get the value of another.
RenderedRay nothing_met() {
    RenderedRay r;
    r.depth = 0.0;
    r.weight = 0.0;
    r.intensity = 0.0;
    r.hit_logit = 0.0;
    r.drop_logit = 0.0;
    r.transmittance = 1.0;
    r.median_depth = 0.0;
    r.n_hits = 0u;
    r.instance = RELIDAR_NO_INSTANCE;
    return r;
}

RenderedGeometry no_geometry() {
    RenderedGeometry q;
    q.normal = vec3(0.0);
    q.distortion = 0.0;
    q.moment = 0.0;
    q.likelihood = 0.0;
    q.mode = 0.0;
    return q;
}

Blended start_blending(TraceScene scene, uint ray_index) {
    Blended b;
    b.ray = nothing_met();
    b.geometry = no_geometry();
    b.surfaces = no_surfaces();
    b.lost = float[](0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    b.first_t = 0.0;
    if (LIKELIHOOD != 0u) take_measured(scene, ray_index);
    ray_basis_instance = kNoInstance;
    return b;
}

vec3 channels_of(TraceScene scene, Ray ray, Hit hit) {
    return hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
}

/// Returns the transmittance behind the next hit.
/// @param transmittance  transmittance before the hit
float left_behind(TraceScene scene, Hit hit, float transmittance) {
    return transmittance * (1.0 - min(hit.alpha, scene.alpha_max));
}

/// Returns true if the ray ends before its next hit. That hit is not blended.
bool ends_before(TraceScene scene, Hit hit, float transmittance) {
    return left_behind(scene, hit, transmittance) < scene.transmittance_min;
}

/// Blends the next hit.
/// @param c  channels of the hit
void blend_hit(TraceScene scene, Ray ray, Hit hit, vec3 c, inout Blended b) {
    float next = left_behind(scene, hit, b.ray.transmittance),
          w = min(hit.alpha, scene.alpha_max) * b.ray.transmittance;
    if (GEOMETRY != 0u) {
        if (b.ray.n_hits == 0u) b.first_t = hit.t;
        add_geometry(scene, ray, hit, w, b.ray.weight, hit.t - b.first_t, b.geometry);
    }
    // M12
    if (LIKELIHOOD != 0u) add_compensated(b.geometry.likelihood, b.lost[5], w * range_kernel(hit.t));
    if (MODE != 0u) add_to_surface(hit.t, w, params.surface_gap_m, b.surfaces);  // M13
    add_compensated(b.ray.depth, b.lost[0], w * hit.t);
    add_compensated(b.ray.weight, b.lost[1], w);
    add_compensated(b.ray.intensity, b.lost[2], w * c.x);
    add_compensated(b.ray.hit_logit, b.lost[3], w * c.y);
    add_compensated(b.ray.drop_logit, b.lost[4], w * c.z);
    bool crosses = b.ray.transmittance > 0.5 && next <= 0.5;
    if (crosses) b.ray.median_depth = hit.t;
    if (crosses || b.ray.n_hits == 0u) b.ray.instance = hit.instance;
    b.ray.transmittance = next;
    ++b.ray.n_hits;
}

/// Stores hit k of the thread's ray, in the order of blending.
void keep_hit(uint k, Hit hit) {
    if (k < params.n_kept) params.kept.at[list_entry(params.n_kept, thread_index(), k)] = hit;
}

/// Adds the background and writes the rendered values of the ray.
void finish_blending(uint ray_index, inout Blended b) {
    if (params.n_kept > 0u && b.ray.n_hits > params.n_kept) atomicAdd(params.n_overfull.at[0], 1u);
    // background: intensity 0, hit 0, drop 1
    add_compensated(b.ray.drop_logit, b.lost[4], b.ray.transmittance);
    weigh_surface(b.surfaces);
    b.geometry.mode = b.surfaces.heaviest_t;
    if (GEOMETRY != 0u || LIKELIHOOD != 0u || MODE != 0u) params.geometry.at[ray_index] = b.geometry;
    params.rendered.at[ray_index] = b.ray;
}
#endif
