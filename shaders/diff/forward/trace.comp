// SPDX-License-Identifier: Apache-2.0
// Forward pass of the renderer without hit lists: finds the hits of a ray in chunks, from
// near to far, and blends them. If hit lists exist, renders only the rays that kernel
// forward/blend could not finish. One thread per ray. Input: scene, lists.lengths.
// Output: rendered, kept, surfaces. Accumulated: scene.pass_cap_count, n_overfull.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../traversal/includes.glsl"
#include "../traversal/likelihood.glsl"
#include "../../base/compensated.glsl"
#include "surfaces.glsl"
RELIDAR_PARAMS(ForwardParams);
#include "blend.glsl"

void render_ray(TraceScene scene, Ray ray, uint ray_index) {
    Blended b = start_blending(scene, ray_index);
    HitKey previous_key = search_start_key(scene);
    bool ended = false;
    for (uint pass = 0u; pass < RELIDAR_MAX_PASSES && !ended; ++pass) {
        find_next_hits(scene, ray, previous_key, transmittance_limit(scene, b.ray.transmittance));
        for (uint i = 0u; i < n_hits; ++i) {
            Hit hit = load_hit(i);
            ended = is_blocked(scene, hit, b.ray.transmittance);
            if (ended) break;
            store_hit(b.ray.n_hits, hit);
            blend_hit(scene, ray, hit, hit_channels(scene, ray, hit), b);
        }
        // Unless hits_closed is set, this pass has found all remaining hits.
        if (!hits_closed) ended = true;
        else previous_key = load_hit_key(n_hits - 1u);
    }
    if (!ended) atomicAdd(scene.pass_cap_count.at[0], 1u);
    finish_blending(ray_index, b);
}

void main() {
    uint i = traced_ray(params.scene);
    if (i >= params.scene.n_rays) return;
    if (!is_null(params.lists.lengths) && params.lists.lengths.at[thread_index()] != RELIDAR_LIST_UNFIT)
        return;
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    render_ray(params.scene, make_ray(entry), i);
}
