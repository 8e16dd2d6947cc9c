// SPDX-License-Identifier: Apache-2.0
// Where next_hits() puts what a ray meets: a buffer of the thread's own, which holds the nearest CHUNK hits in order.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_HIT_BUFFER_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_HIT_BUFFER_GLSL
RELIDAR_CONSTANT(uint, CHUNK, 16u);

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

/// Where the last hit lies, behind which a closed buffer takes none.
float last_hit_t() { return hit_t[n_hits - 1u]; }

/// Whether a hit can not matter any more in this pass.
bool is_behind(Key key) { return hits_closed && !before(key, hit_key(n_hits - 1u)); }

void reset_hits(float budget) {
    n_hits = 0u;
    n_places = 0u;
    hits_closed = false;
    hits_optical_depth = 0.0;
    optical_budget = budget;
}
#endif
