// SPDX-License-Identifier: Apache-2.0
// The traversal contract. next_hits() fills the hit buffer with the at most CHUNK surfels
// that the ray meets strictly after the key `after`, in ascending order of the key (t,
// instance, surfel). Each surfel is included at most once. In a kernel that appends
// (RELIDAR_APPENDS_HITS), next_hits() writes all hits that can contribute to the ray's
// list, unordered.
//
// A backend only proposes candidate ids through offer(). Intersection, order, removal of
// duplicates and insertion are in this file and in hit_buffer.glsl or hit_list.glsl, so
// backends cannot disagree. See README.md in this folder.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_TRAVERSAL_GLSL
#include "keys.glsl"
#include "ray.glsl"

// Size of every dynamically indexed array of this shader, whatever the chunk size.
// Compilers turn small arrays into selects over registers, which then spill. Mesa's AMD
// compiler does so up to 256 bytes, Intel's compiler up to 16 elements. Larger arrays
// stay in memory.
const uint SLOTS = 65u;

#ifdef RELIDAR_APPENDS_HITS
#include "hit_list.glsl"
#else
#include "hit_buffer.glsl"
#endif

/// Intersects the ray with a surfel that a backend proposes, and inserts the hit if there
/// is one.
/// @param surfel  index in the scene. The surfel belongs to the current instance.
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

/// Loads and tests a surfel that a backend proposes.
/// @param local_surfel  index relative to the first surfel of the instance
void offer(TraceScene scene, Ray ray, Key after, uint instance, uint local_surfel) {
    enter_instance(scene, ray, instance);
    offer_surfel(scene, after, instance, entered_first_surfel + local_surfel);
}

/// Returns a sort key before all hits that the sensor can see. Hits at t <= near_m are
/// ignored.
Key first_key(TraceScene scene) { return Key(scene.near_m, 0xffffffffu, 0xffffffffu); }

/// Returns the distance at which a continued search may start, because all nearer hits
/// are known. The margin is much larger than the rounding error of a backend's t.
float search_start(Key after) { return max(after.t - (1e-4 + 1e-5 * after.t), 0.0); }

/// Returns the limit for the transmittance of further hits at which the ray ends. The
/// factor 0.99 allows for rounding of the product.
/// @param transmittance  transmittance of the ray so far
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
