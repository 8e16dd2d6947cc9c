// SPDX-License-Identifier: Apache-2.0
// Forward pass (Eq. 2-4; M4, M5): collects hits chunk by chunk, blends nearest first. One thread a ray.
// Where the geometric losses want them, also the blended normal and the distortion (M10, M11), and the likelihood (M12); where a
// range image wants it the heaviest surface (M13).
// Input: scene (rays, records, instances, sh, acceleration structure, targets). Output: rendered, kept, geometry. Accumulated:
// scene.pass_cap_count, n_overfull.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../traversal/includes.glsl"
#include "../traversal/facing_normal.glsl"
#include "../traversal/likelihood.glsl"
#include "../common/compensated.glsl"
#include "surfaces.glsl"
RELIDAR_PARAMS(ForwardParams);

/// Takes a hit into the geometry of its ray; `beyond` is its distance behind the first hit, of which no digits are lost in M10's sums.
/// @param before  weight of the hits before it
void add_geometry(TraceScene scene, Ray ray, Hit hit, float w, float before, float beyond, inout RenderedGeometry q) {
    q.distortion += w * (beyond * before - q.moment);   // M10
    q.moment += w * beyond;
    q.normal += w * facing_normal(scene, ray, hit.instance, hit.surfel);
}

/// Field by field, so that a new one has its line and none takes another's place.
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

RenderedRay render(TraceScene scene, Ray ray, uint ray_index) {
    RenderedRay r = nothing_met();
    float lost[6] = float[](0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    RenderedGeometry geometry = no_geometry();
    Surfaces surfaces = no_surfaces();
    if (LIKELIHOOD != 0u) take_measured(scene, ray_index);
    float first_t = 0.0;
    ray_basis_instance = kNoInstance;
    Key after = first_key(scene);
    bool ended = false;
    uint pass = 0u;
    for (; pass < RELIDAR_MAX_PASSES && !ended; ++pass) {
        next_hits(scene, ray, after, remaining_budget(scene, r.transmittance));
        for (uint i = 0u; i < n_hits && !ended; ++i) {
            Hit hit = hit_at(i);
            float alpha = min(hit.alpha, scene.alpha_max);
            float next = r.transmittance * (1.0 - alpha);
            if (next < scene.transmittance_min) { ended = true; break; }
            float w = alpha * r.transmittance;
            vec3 c = hit_channels(scene, ray, hit.instance, hit.surfel, scene.records.at[hit.surfel]);
            if (GEOMETRY != 0u) {
                if (r.n_hits == 0u) first_t = hit.t;
                add_geometry(scene, ray, hit, w, r.weight, hit.t - first_t, geometry);
            }
            if (LIKELIHOOD != 0u) add_compensated(geometry.likelihood, lost[5], w * range_kernel(hit.t));   // M12
            if (MODE != 0u) add_to_surface(hit.t, w, params.surface_gap_m, surfaces);                        // M13
            add_compensated(r.depth, lost[0], w * hit.t);
            add_compensated(r.weight, lost[1], w);
            add_compensated(r.intensity, lost[2], w * c.x);
            add_compensated(r.hit_logit, lost[3], w * c.y);
            add_compensated(r.drop_logit, lost[4], w * c.z);
            bool crosses = r.transmittance > 0.5 && next <= 0.5;
            if (crosses) r.median_depth = hit.t;
            if (crosses || r.n_hits == 0u) r.instance = hit.instance;
            r.transmittance = next;
            if (r.n_hits < params.n_kept) params.kept.at[ray_index * params.n_kept + r.n_hits] = KeptHit(hit.instance, hit.surfel);
            ++r.n_hits;
        }
        if (!hits_closed) ended = true;
        else after = hit_key(n_hits - 1u);
    }
    if (!ended) atomicAdd(scene.pass_cap_count.at[0], 1u);
    if (params.n_kept > 0u && r.n_hits > params.n_kept) atomicAdd(params.n_overfull.at[0], 1u);
    add_compensated(r.drop_logit, lost[4], r.transmittance);   // background: intensity 0, hit 0, drop 1
    weigh_surface(surfaces);
    geometry.mode = surfaces.heaviest_t;
    if (GEOMETRY != 0u || LIKELIHOOD != 0u || MODE != 0u) params.geometry.at[ray_index] = geometry;
    return r;
}

void main() {
    uint i = traced_ray(params.scene);
    if (i >= params.scene.n_rays) return;
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    params.rendered.at[i] = render(params.scene, Ray(entry.origin, entry.direction), i);
}
