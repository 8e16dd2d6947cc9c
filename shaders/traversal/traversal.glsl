// SPDX-License-Identifier: Apache-2.0
// The traversal contract. next_hits() fills the hit buffer with the at most CHUNK surfels that the ray meets strictly after the
// key `after`, ascending by key (t, instance, surfel), each at most once. A backend only proposes candidate ids through offer();
// intersection, order, de-duplication and insertion are here, so backends cannot disagree. See README.md beside this file.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_TRAVERSAL_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_TRAVERSAL_GLSL
RELIDAR_CONSTANT(uint, CHUNK, 16u);

struct Key {
    float t;
    uint instance;
    uint surfel;
};

struct Ray {
    vec3 origin;      // world, m
    vec3 direction;   // world, unit
};

// Slots of every array of this shader that is indexed at run time, whatever the chunk. Compilers turn small ones into a ladder of selects
// over registers, which then spill: Mesa's AMD compiler all up to 256 bytes, Intel's all up to 16 elements. A larger one is memory.
const uint SLOTS = 65u;

/// A hit in the buffer.
struct Hit {
    float t;
    float alpha;      // sigma G, not clamped
    uint instance;
    uint surfel;
};

// The buffer: hits in the order of their keys, nearest first, CHUNK of them at most. Only what is compared lies in order; the rest of a hit
// stays where it was put, so that making room moves two words a hit.
float hit_t[SLOTS];
uint hit_place[SLOTS];     // where the rest of it lies; behind the last hit: places of dropped ones, to be taken again
uint n_hits;
uint n_places;             // taken so far, at most CHUNK
float placed_alpha[SLOTS];
uint placed_instance[SLOTS];
uint placed_surfel[SLOTS];
bool hits_closed;          // nothing beyond the last hit can matter any more in this pass: the ray may end there
float hits_optical_depth;  // sum of -log(1 - alpha) over the buffer
float optical_budget;      // hits behind this optical depth cannot be blended; huge = keep all

// The ray in the frame of the model that was met last: candidates come in runs of one instance.
uint entered_instance = 0xffffffffu;
uint entered_first_surfel;
vec3 entered_origin;
vec3 entered_direction;

/// The ray of this thread, in the order of the batch; n_rays and more: none. In an image, 8 threads in sequence are 4 x 2 neighbours, and
/// 32 are 8 x 4: they open the same nodes. Tiles run down the image, then across: a driver that gives each of its threads one stretch of
/// the workgroups (lavapipe) so gives each a like share of sky and ground, which cost differently.
uint traced_ray(TraceScene scene) {
    uint i = thread_index();
    if (scene.columns == 0u) return i;
    uint tile = i >> 5u, down = (scene.n_rays / scene.columns + 3u) >> 2u;
    uint x = (tile / down) * 8u + ((i >> 1u) & 4u) + (i & 3u);
    uint y = (tile % down) * 4u + ((i >> 3u) & 2u) + ((i >> 2u) & 1u);
    return x < scene.columns ? y * scene.columns + x : scene.n_rays;
}

bool before(Key a, Key b) {
    if (a.t != b.t) return a.t < b.t;
    if (a.instance != b.instance) return a.instance < b.instance;
    return a.surfel < b.surfel;
}

/// Hit i of the buffer, 0 the nearest.
Hit hit_at(uint i) {
    uint place = hit_place[i];
    return Hit(hit_t[i], placed_alpha[place], placed_instance[place], placed_surfel[place]);
}

Key hit_key(uint i) { return Key(hit_t[i], placed_instance[hit_place[i]], placed_surfel[hit_place[i]]); }

/// A place for the rest of a hit: that of one that was dropped, or a new one.
uint take_place() { return n_places > n_hits ? hit_place[n_hits] : n_places++; }

/// Writes a hit into a slot of the buffer.
void put_hit(uint slot, uint place, Hit hit) {
    hit_t[slot] = hit.t;
    hit_place[slot] = place;
    placed_alpha[place] = hit.alpha;
    placed_instance[place] = hit.instance;
    placed_surfel[place] = hit.surfel;
}

vec3 model_point(InstanceEntry m, vec3 p) {
    return vec3(exact_dot(m.row0.xyz, p) + m.row0.w, exact_dot(m.row1.xyz, p) + m.row1.w, exact_dot(m.row2.xyz, p) + m.row2.w);
}
vec3 model_vector(InstanceEntry m, vec3 d) {
    return vec3(exact_dot(m.row0.xyz, d), exact_dot(m.row1.xyz, d), exact_dot(m.row2.xyz, d));
}
vec3 world_vector(InstanceEntry m, vec3 g) { return m.row0.xyz * g.x + m.row1.xyz * g.y + m.row2.xyz * g.z; }

void enter_instance(TraceScene scene, Ray ray, uint instance) {
    if (entered_instance == instance) return;
    InstanceEntry m = scene.instances.at[instance];
    entered_instance = instance;
    entered_first_surfel = m.first_surfel;
    entered_origin = model_point(m, ray.origin);
    entered_direction = model_vector(m, ray.direction);
}

float optical_depth(float alpha, float alpha_max) { return -log(1.0 - min(alpha, alpha_max)); }

/// Drops the farthest hits while those before them already end the ray (T under T_min whatever comes behind).
void cut_by_transmittance(float alpha_max) {
    while (hits_optical_depth >= optical_budget && n_hits > 1u) {
        float last = optical_depth(hit_at(n_hits - 1u).alpha, alpha_max);
        if (hits_optical_depth - last < optical_budget) return;
        hits_optical_depth -= last;
        --n_hits;
        hits_closed = true;
    }
}

/// Whether the hit is in the buffer. Equal keys are rare: t alone is looked at as long as it decides.
bool is_known(Key key) {
    uint slot = n_hits;
    while (slot > 0u && hit_t[slot - 1u] > key.t) --slot;
    while (slot > 0u && before(key, hit_key(slot - 1u))) --slot;
    return slot > 0u && hit_key(slot - 1u) == key;
}

/// Takes a hit into the buffer; the farthest one leaves where it is full. Each hit is moved once, as its place is looked for.
void insert(Key key, float alpha, float alpha_max) {
#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
    if (is_known(key)) return;   // the second triangle of one surfel, or a box the driver reports twice
#endif
    if (n_hits == CHUNK) {
        --n_hits;
        hits_optical_depth -= optical_depth(hit_at(n_hits).alpha, alpha_max);
    }
    uint slot = n_hits, own_place = take_place();
    for (; slot > 0u; --slot) {
        float t = hit_t[slot - 1u];
        uint place = hit_place[slot - 1u];
        if (!(t >= key.t)) break;
        if (t == key.t && before(Key(t, placed_instance[place], placed_surfel[place]), key)) break;
        hit_t[slot] = t;
        hit_place[slot] = place;
    }
    put_hit(slot, own_place, Hit(key.t, alpha, key.instance, key.surfel));
    ++n_hits;
    hits_optical_depth += optical_depth(alpha, alpha_max);
    if (n_hits == CHUNK) hits_closed = true;
    cut_by_transmittance(alpha_max);
}

/// Takes a candidate proposed by a backend: a surfel of the instance that was entered last, counted in the scene.
void offer_surfel(TraceScene scene, Key after, uint instance, uint surfel) {
    SurfelHit hit;
    if (!intersect(scene.records.at[surfel], entered_origin, entered_direction, hit)) return;
    if (!(hit.alpha >= scene.alpha_min)) return;
    Key key = Key(hit.t, instance, surfel);
    if (!before(after, key)) return;
    if (hits_closed && !before(key, hit_key(n_hits - 1u))) return;
    insert(key, hit.alpha, scene.alpha_max);
}

/// The same of any instance, counted from its first surfel.
void offer(TraceScene scene, Ray ray, Key after, uint instance, uint local_surfel) {
    enter_instance(scene, ray, instance);
    offer_surfel(scene, after, instance, entered_first_surfel + local_surfel);
}

void reset_hits(float budget) {
    n_hits = 0u;
    n_places = 0u;
    hits_closed = false;
    hits_optical_depth = 0.0;
    optical_budget = budget;
}

/// The key before the first hit a sensor can see: hits at t <= near are ignored.
Key first_key(TraceScene scene) { return Key(scene.near_m, 0xffffffffu, 0xffffffffu); }

/// Where a continued search may start: hits before are known. Rounding of a backend's own t is far below this (docs: platform).
float search_start(Key after) { return max(after.t - (1e-4 + 1e-5 * after.t), 0.0); }

/// Optical depth still to go before a ray that has transmittance T left must end, with room for rounding of the sum.
float remaining_budget(TraceScene scene, float transmittance) {
    return log(transmittance / scene.transmittance_min) + 0.01;
}

#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
#include "ray_query.glsl"
#elif defined(RELIDAR_TRAVERSAL_SOFTWARE_BVH)
#include "software_bvh.glsl"
#else
#include "brute_force.glsl"
#endif
#endif
