// SPDX-License-Identifier: Apache-2.0
// Finds the hits of a ray by testing every surfel of every instance. Tests compare the
// acceleration structures with this search.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_BRUTE_FORCE_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_BRUTE_FORCE_GLSL

void find_hits(TraceScene scene, Ray ray, HitKey previous_key) {
    for (uint instance = 0u; instance < scene.n_instances; ++instance) {
        uint count = scene.instances.at[instance].n_surfels;
        for (uint i = 0u; i < count; ++i) test_instance_surfel(scene, ray, previous_key, instance, i);
    }
}
#endif
