// SPDX-License-Identifier: Apache-2.0
// Forward pass: blends the hits of sorted lists (blend.glsl). One thread a ray. Leaves a ray to forward/trace where its list is unfit: too
// short, or closed too early by hits that were reported twice.
// Input: scene (records, instances, sh, targets; rays where SH are evaluated a hit or there is geometry), lists. Output: rendered, kept,
// geometry, lists.lengths. Accumulated: n_overfull.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/trace.h"
#include "../gaussian/primitive.glsl"
#include "../gaussian/sh.glsl"
#include "../traversal/keys.glsl"
#include "../traversal/ray.glsl"
#include "../traversal/shading.glsl"
#include "../traversal/facing_normal.glsl"
#include "../traversal/likelihood.glsl"
#include "../common/compensated.glsl"
#include "surfaces.glsl"
RELIDAR_PARAMS(ForwardParams);
#include "blend.glsl"

void main() {
    uint list = thread_index(), i = traced_ray(params.scene);
    if (i >= params.scene.n_rays) return;
    uint length = params.lists.lengths.at[list];
    if (length == RELIDAR_LIST_UNFIT) return;
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    Ray ray = Ray(entry.origin, entry.direction);
    Blended b = start_blending(params.scene, i);
    bool ended = false;
    Key last = Key(-1.0, 0u, 0u);
    for (uint k = 0u; k < (length & ~RELIDAR_LIST_CLOSED) && !ended; ++k) {
        Hit hit = params.lists.hits.at[list_entry(params.lists.room, list, k)];
        Key key = Key(hit.t, hit.instance, hit.surfel);
        if (key == last) continue;   // reported twice
        last = key;
        uint n_before = b.ray.n_hits;
        ended = blend_hit(params.scene, ray, hit, b);
        if (!ended && (params.kept_in_lists == 0u || n_before != k)) keep_hit(n_before, hit);
    }
    if ((length & RELIDAR_LIST_CLOSED) != 0u && !ended) params.lists.lengths.at[list] = RELIDAR_LIST_UNFIT;
    else finish_blending(i, b);
}
