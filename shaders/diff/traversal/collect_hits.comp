// SPDX-License-Identifier: Apache-2.0
// Writes all hits of each ray from near to far, even if the transmittance is already low.
// Tests compare these hits between the acceleration structures. One thread per ray.
// Input: scene. Output: counts, hits.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "includes.glsl"
RELIDAR_PARAMS(CollectHitsParams);

void main() {
    uint ray_index = traced_ray(params.scene);
    if (ray_index >= params.scene.n_rays) return;
    DeviceRay entry = params.scene.rays.at[params.scene.first_ray + ray_index * params.scene.ray_stride];
    Ray ray = make_ray(entry);
    HitKey previous_key = search_start_key(params.scene);
    uint count = 0u;
    bool more = true;
    for (uint pass = 0u; pass < RELIDAR_MAX_PASSES && more; ++pass) {
        find_next_hits(params.scene, ray, previous_key, 0.0);
        for (uint i = 0u; i < n_hits; ++i, ++count) {
            // Hits beyond max_hits are counted but not stored.
            if (count < params.max_hits) params.hits.at[ray_index * params.max_hits + count] = load_hit(i);
        }
        // If hits_closed is false, this pass has found all remaining hits.
        more = hits_closed;
        if (more) previous_key = load_hit_key(n_hits - 1u);
    }
    if (more) atomicAdd(params.scene.pass_cap_count.at[0], 1u);
    params.counts.at[ray_index] = count;
}
