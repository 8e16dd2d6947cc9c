// SPDX-License-Identifier: Apache-2.0
// Forward pass of the renderer with sorted hit lists: blends the hits of each ray. Marks
// a list as unfit if it is too short or incomplete, so that kernel forward/trace renders
// the ray instead. A list can be incomplete because the driver reported a hit twice. One
// thread per ray.
//
// Input: scene (records, instances, sh, targets, and rays if SH are evaluated per hit or
// normals are blended), lists. Output: rendered, kept, surfaces, lists.lengths.
// Accumulated: n_overfull.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/trace.h"
#include "../../scene/gaussian/primitive.glsl"
#include "../../scene/gaussian/sh.glsl"
#include "../traversal/keys.glsl"
#include "../traversal/ray.glsl"
#include "../traversal/shading.glsl"
#include "../traversal/likelihood.glsl"
#include "../../base/compensated.glsl"
#include "surfaces.glsl"
RELIDAR_PARAMS(ForwardParams);
#include "blend.glsl"

/// Returns hit `index` of a sorted list, or the last hit if the list is shorter.
Hit load_clamped(uint list, uint index, uint hit_count) {
    return params.lists.hits.at[hit_list_index(params.lists.room, list, min(index, hit_count - 1u))];
}

/// Blends the hits of a list with at least one hit. To hide the latency of loads, loads
/// each hit two iterations before it is blended, and its intensity and logits one
/// iteration before.
/// @return true if a hit of the list would reduce the transmittance below the limit
bool blend_list(uint list, uint hit_count, Ray ray, inout Blended blended) {
    Hit next = load_clamped(list, 0u, hit_count), after_next = load_clamped(list, 1u, hit_count);
    vec3 next_channels = hit_channels(params.scene, ray, next);
    HitKey last = HitKey(-1.0, 0u, 0u);
    for (uint k = 0u; k < hit_count; ++k) {
        Hit hit = next;
        vec3 channels = next_channels;
        next = after_next;
        after_next = load_clamped(list, k + 2u, hit_count);
        next_channels = hit_channels(params.scene, ray, next);
        HitKey key = HitKey(hit.t, hit.instance, hit.surfel);
        if (key == last) continue;  // skips a hit that the driver reported twice
        last = key;
        if (is_blocked(params.scene, hit, blended.ray.transmittance)) return true;
        if (params.kept_in_lists == 0u || blended.ray.n_hits != k) store_hit(blended.ray.n_hits, hit);
        blend_hit(params.scene, ray, hit, channels, blended);
    }
    return false;
}

void main() {
    uint list = thread_index(), i = traced_ray(params.scene);
    if (i >= params.scene.n_rays) return;
    uint length = params.lists.lengths.at[list];
    if (length == RELIDAR_LIST_UNFIT) return;
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
    Ray ray = make_ray(entry);
    Blended b = start_blending(params.scene, i);
    uint n = length & ~RELIDAR_LIST_CLOSED;
    bool ended = n > 0u && blend_list(list, n, ray, b);
    // A closed list must end the ray. Otherwise a hit was reported twice, and the list
    // may lack hits.
    if ((length & RELIDAR_LIST_CLOSED) != 0u && !ended) params.lists.lengths.at[list] = RELIDAR_LIST_UNFIT;
    else finish_blending(i, b);
}
