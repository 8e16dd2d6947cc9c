// SPDX-License-Identifier: Apache-2.0
// Where next_hits() puts what a ray meets: a buffer of the thread's own, which holds the
// nearest CHUNK hits in order.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
RELIDAR_CONSTANT(uint, CHUNK, 16u);

// The buffer, while it is filled: a ring of at most CHUNK places from the farthest hit to
// the nearest, so that a hit is put between two others and none is moved. Place CHUNK is
// no hit: it follows the nearest one, and the farthest follows it. A hit's place is
// looked for from the far end, for hits are found roughly from near to far, or from the
// latest hit on, where it is nearer than that: they come in clusters.
const float kFar = 1e38;
float placed_t[SLOTS];
uint next_nearer[SLOTS];  // place of the next nearer hit
float placed_alpha[SLOTS];
uint placed_instance[SLOTS];
uint placed_surfel[SLOTS];
uint n_hits;
uint n_places;     // taken so far
uint free_place;   // one whose hit was dropped, CHUNK for none; next_nearer is the next such place
uint latest;       // the hit that was taken last
float latest_t;    // -kFar: it was dropped
float farthest_t;  // of the last hit, where hits_closed
bool hits_closed;  // nothing beyond the last hit can matter any more in this pass: the ray may end there
float hits_transmittance;   // product of 1 - alpha over the buffer
float least_transmittance;  // once it is less, hits behind cannot be blended; 0: keep all

// When it is filled: places in the order of the hits' keys, nearest first.
uint hit_place[SLOTS];

Hit placed_hit(uint place) {
    return Hit(placed_t[place], placed_alpha[place], placed_instance[place], placed_surfel[place]);
}
Key placed_key(uint place) { return Key(placed_t[place], placed_instance[place], placed_surfel[place]); }

/// Hit i of the filled buffer, 0 the nearest.
Hit hit_at(uint i) { return placed_hit(hit_place[i]); }
Key hit_key(uint i) { return placed_key(hit_place[i]); }

/// Writes a hit to a place of the buffer.
void place_hit(uint place, Hit hit) {
    placed_t[place] = hit.t;
    placed_alpha[place] = hit.alpha;
    placed_instance[place] = hit.instance;
    placed_surfel[place] = hit.surfel;
}

/// Appends a hit that is known to be the next farther one.
void append_hit(Hit hit) {
    place_hit(n_hits, hit);
    hit_place[n_hits] = n_hits;
    ++n_hits;
}

/// Puts the places of a filled ring in order.
void order_hits() {
    uint place = next_nearer[CHUNK];
    for (uint i = n_hits; i > 0u; --i) {
        hit_place[i - 1u] = place;
        place = next_nearer[place];
    }
}

/// Takes the farthest hit out. @param left  transmittance of the others @return its place
uint drop_farthest(float left) {
    uint place = next_nearer[CHUNK];
    next_nearer[CHUNK] = next_nearer[place];
    hits_transmittance = left;
    if (place == latest) latest_t = -kFar;
    --n_hits;
    return place;
}

/// Transmittance of the hits before the farthest one.
float left_before_farthest(float alpha_max) {
    return hits_transmittance / (1.0 - min(placed_alpha[next_nearer[CHUNK]], alpha_max));
}

/// Drops the farthest hits while those before them already end the ray (T under T_min
/// whatever comes behind).
void cut_by_transmittance(float alpha_max) {
    // mostly; a CPU would run through the loop once
    if (!(hits_transmittance < least_transmittance)) return;
    while (n_hits > 1u) {
        float left = left_before_farthest(alpha_max);
        if (!(left < least_transmittance)) return;
        uint place = drop_farthest(left);
        next_nearer[place] = free_place;
        free_place = place;
        hits_closed = true;
    }
}

/// A place for a hit: that of a dropped one, or a new one.
uint take_place(float alpha_max) {
    if (n_hits == CHUNK) return drop_farthest(left_before_farthest(alpha_max));
    uint place = free_place;
    if (place == CHUNK) return n_places++;
    free_place = next_nearer[place];
    return place;
}

/// Takes a hit into the buffer; the farthest one leaves where it is full.
void insert(Key key, float alpha, float alpha_max) {
    uint farther = key.t < latest_t ? latest : CHUNK, nearer = next_nearer[farther];
    for (;;) {
        float t = placed_t[nearer];
        if (!(t >= key.t)) break;
        if (t == key.t) {  // rare
            Key known = placed_key(nearer);
            // the second triangle of one surfel, or a box the driver reports twice
            if (known == key) return;
            if (before(known, key)) break;
        }
        farther = nearer;
        nearer = next_nearer[nearer];
    }
    uint own = take_place(alpha_max);
    if (own == farther) farther = CHUNK;  // it was the farthest hit's
    place_hit(own, Hit(key.t, alpha, key.instance, key.surfel));
    latest = own;
    latest_t = key.t;
    next_nearer[own] = nearer;
    next_nearer[farther] = own;
    ++n_hits;
    hits_transmittance *= 1.0 - min(alpha, alpha_max);
    if (n_hits == CHUNK) hits_closed = true;
    cut_by_transmittance(alpha_max);
    if (hits_closed) farthest_t = placed_t[next_nearer[CHUNK]];
}

/// Where the last hit lies, behind which a closed buffer takes none.
float last_hit_t() { return farthest_t; }

/// Whether a hit can not matter any more in this pass.
bool is_behind(Key key) {
    if (!hits_closed || key.t < farthest_t) return false;
    return key.t > farthest_t || !before(key, placed_key(next_nearer[CHUNK]));
}

void reset_hits(float least) {
    n_hits = 0u;
    n_places = 0u;
    free_place = CHUNK;
    placed_t[CHUNK] = -kFar;  // nearer than any hit
    next_nearer[CHUNK] = CHUNK;
    latest_t = -kFar;
    hits_closed = false;
    hits_transmittance = 1.0;
    least_transmittance = least;
}
#endif
