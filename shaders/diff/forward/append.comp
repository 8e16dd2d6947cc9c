// SPDX-License-Identifier: Apache-2.0
// Writes all hits of a ray that can contribute to its result to the ray's hit list, in
// any order. One thread per ray. Input: scene (rays, records, instances, acceleration
// structure). Output: lists. Accumulated: scene.pass_cap_count, n_overflows.
#version 460
#extension GL_GOOGLE_include_directive : require
#define RELIDAR_APPENDS_HITS
#include "../traversal/includes.glsl"
RELIDAR_PARAMS(AppendParams);

void main() {
    list_index = thread_index();
    if (list_index >= params.lists.n) return;
    uint i = traced_ray(params.scene), length = 0u;
    if (i < params.scene.n_rays) {
        DeviceRay entry = params.scene.rays.at[params.scene.first_ray + i * params.scene.ray_stride];
        listed = params.lists;
        find_next_hits(params.scene, make_ray(entry), search_start_key(params.scene),
                       transmittance_limit(params.scene, 1.0));
        length = n_hits | (hits_closed ? RELIDAR_LIST_CLOSED : 0u);
        // More hits than fit into the list: kernel forward/trace renders this ray.
        if (n_hits > params.lists.room) {
            length = RELIDAR_LIST_UNFIT;
            atomicAdd(params.n_overflows.at[0], 1u);
        }
    }
    params.lists.lengths.at[list_index] = length;
}
