// SPDX-License-Identifier: Apache-2.0
// Interface of all traversal methods.
// find_next_hits() finds the nearest hits of a ray that come after the sort key `after`.
// It writes at most CHUNK hits to the hit buffer, sorted by the key (t, instance,
// surfel), each surfel at most once. In kernels with RELIDAR_APPENDS_HITS,
// find_next_hits() writes all hits that can contribute to the ray's hit list, unordered.
//
// A traversal method only calls test_instance_surfel() with the surfels that a ray may
// hit. This file and hit_buffer.glsl or hit_list.glsl intersect the surfels, sort the
// hits and remove duplicates. Therefore all methods give the same hits.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#include "keys.glsl"
#include "ray.glsl"

// Number of elements of the arrays that are indexed at run time. They must stay in
// memory, because a shader has too few registers for them. Some compilers keep small
// arrays in registers: Mesa's AMD compiler up to 64 elements, Intel's up to 16. The value
// 65 exceeds both limits.
const uint SLOTS = 65u;

#ifdef RELIDAR_APPENDS_HITS
#include "hit_list.glsl"
#else
#include "hit_buffer.glsl"
#endif

/// Intersects the ray with a surfel that the traversal has found. Stores the hit, if
/// there is one.
/// @param surfel index in the scene. The surfel must belong to the current instance
void test_record(TraceScene scene, HitKey previous_key, uint instance, uint surfel, SurfelRecord record) {
    SurfelHit hit;
    if (!intersect(record, entered_origin, entered_direction, hit)) return;
    if (!(hit.alpha >= scene.alpha_min)) return;
    HitKey key = HitKey(hit.t, instance, surfel);
    if (!is_key_before(previous_key, key)) return;
    if (is_behind_last(key)) return;
    insert_hit(key, hit.alpha, scene.alpha_max);
}

void test_surfel(TraceScene scene, HitKey previous_key, uint instance, uint surfel) {
    test_record(scene, previous_key, instance, surfel, scene.records.at[surfel]);
}

/// Loads a surfel that the traversal has found, and tests it against the ray.
/// @param local_surfel index relative to the first surfel of the instance
void test_instance_surfel(TraceScene scene, Ray ray, HitKey previous_key, uint instance, uint local_surfel) {
    enter_instance(scene, ray, instance);
    test_surfel(scene, previous_key, instance, entered_first_surfel + local_surfel);
}

/// Returns the sort key (t, instance, surfel) after which the search for hits starts.
/// Hits at t <= near_m are skipped, because they are too close to the sensor.
HitKey search_start_key(TraceScene scene) { return HitKey(scene.near_m, 0xffffffffu, 0xffffffffu); }

/// Returns the distance at which the search for the hits behind a known hit starts. It is
/// slightly nearer than the known hit because of rounding errors.
float search_start_t(HitKey previous_key) {
    return max(previous_key.t - (1e-4 + 1e-5 * previous_key.t), 0.0);
}

/// Returns a limit for the product of 1 - alpha over the next hits. If the product is
/// below the limit, the total transmittance is below transmittance_min, and the ray ends.
/// The factor 0.99 allows for rounding errors.
/// @param transmittance_before transmittance of the ray before these hits
float transmittance_limit(TraceScene scene, float transmittance_before) {
    return 0.99 * scene.transmittance_min / transmittance_before;
}

#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
#include "ray_query.glsl"
#elif defined(RELIDAR_TRAVERSAL_SOFTWARE_BVH)
#include "software_bvh.glsl"
#else
/// Tests every surfel of every instance. Tests compare the acceleration structures with
/// this search.
void find_hits(TraceScene scene, Ray ray, HitKey previous_key) {
    for (uint instance = 0u; instance < scene.n_instances; ++instance) {
        uint count = scene.instances.at[instance].n_surfels;
        for (uint i = 0u; i < count; ++i) test_instance_surfel(scene, ray, previous_key, instance, i);
    }
}
#endif

void find_next_hits(TraceScene scene, Ray ray, HitKey previous_key, float min_transmittance) {
    reset_hits(min_transmittance);
    find_hits(scene, ray, previous_key);
    sort_hits();
}
#endif
