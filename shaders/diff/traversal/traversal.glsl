// SPDX-License-Identifier: Apache-2.0
// The traversal contract. next_hits() fills the hit buffer with the at most CHUNK surfels
// that the ray meets strictly after the key `after`, ascending by key (t, instance,
// surfel), each at most once; in a kernel that appends (RELIDAR_APPENDS_HITS) the ray's
// list with all that can matter, unordered. A backend only proposes candidate ids through
// offer(); intersection, order, de-duplication and insertion are here and in
// hit_buffer.glsl or hit_list.glsl, so backends cannot disagree. See README.md beside
// this file.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#include "keys.glsl"
#include "ray.glsl"

// Slots of every array of this shader that is indexed at run time, whatever the chunk.
// Compilers turn small ones into a ladder of selects over registers, which then spill:
// Mesa's AMD compiler all up to 256 bytes, Intel's all up to 16 elements. A larger one is
// memory.
const uint SLOTS = 65u;

#ifdef RELIDAR_APPENDS_HITS
#include "hit_list.glsl"
#else
#include "hit_buffer.glsl"
#endif

/// Takes a candidate proposed by a backend: a surfel of the instance that was entered
/// last, counted in the scene, and its record.
void offer_record(TraceScene scene, Key after, uint instance, uint surfel, SurfelRecord record) {
    SurfelHit hit;
    if (!intersect(record, entered_origin, entered_direction, hit)) return;
    if (!(hit.alpha >= scene.alpha_min)) return;
    Key key = Key(hit.t, instance, surfel);
    if (!before(after, key)) return;
    if (is_behind(key)) return;
    insert(key, hit.alpha, scene.alpha_max);
}

void offer_surfel(TraceScene scene, Key after, uint instance, uint surfel) {
    offer_record(scene, after, instance, surfel, scene.records.at[surfel]);
}

/// The same of any instance, counted from its first surfel.
void offer(TraceScene scene, Ray ray, Key after, uint instance, uint local_surfel) {
    enter_instance(scene, ray, instance);
    offer_surfel(scene, after, instance, entered_first_surfel + local_surfel);
}

/// The key before the first hit a sensor can see: hits at t <= near are ignored.
Key first_key(TraceScene scene) { return Key(scene.near_m, 0xffffffffu, 0xffffffffu); }

/// Where a continued search may start: hits before are known. Rounding of a backend's own
/// t is far below this (docs: platform).
float search_start(Key after) { return max(after.t - (1e-4 + 1e-5 * after.t), 0.0); }

/// Transmittance of further hits with which a ray that has this much left must end, with
/// room for rounding of the product.
float least_of_rest(TraceScene scene, float transmittance) {
    return 0.99 * scene.transmittance_min / transmittance;
}

#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
#include "ray_query.glsl"
#elif defined(RELIDAR_TRAVERSAL_SOFTWARE_BVH)
#include "software_bvh.glsl"
#else
#include "brute_force.glsl"
#endif

void next_hits(TraceScene scene, Ray ray, Key after, float least) {
    reset_hits(least);
    find_hits(scene, ray, after);
    order_hits();
}
#endif
