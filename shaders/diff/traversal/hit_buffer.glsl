// SPDX-License-Identifier: Apache-2.0
// Buffer for the nearest hits of a ray. Each thread has one buffer, which holds at most
// CHUNK hits in order. next_hits() fills it.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
RELIDAR_CONSTANT(uint, CHUNK, 16u);

// While the buffer is filled, it is a linked ring of at most CHUNK slots, from the
// farthest hit to the nearest. A hit is inserted without moving others. Slot CHUNK is a
// sentinel between the nearest and the farthest hit. The search for an insertion point
// starts at the far end, because hits arrive roughly from near to far. It starts at the
// latest hit if the new hit is nearer than that, because hits arrive in clusters.
const float kFar = 1e38;
float placed_t[SLOTS];
uint next_nearer[SLOTS];  // slot of the next nearer hit
float placed_alpha[SLOTS];
uint placed_instance[SLOTS];
uint placed_surfel[SLOTS];
uint n_hits;
uint n_places;  // slots used so far
// First free slot of a removed hit, or CHUNK if no slot is free. The array next_nearer
// links the free slots.
uint free_place;
uint latest;       // slot of the hit that was inserted last
float latest_t;    // Distance of the hit that was inserted last, or -kFar if this hit was removed.
float farthest_t;  // distance of the farthest hit, if hits_closed
// True if hits beyond the last hit cannot contribute in this pass, so that the search may
// end there.
bool hits_closed;
float hits_transmittance;  // product of 1 - alpha over the buffer
// Transmittance below which the ray ends, so hits farther away are not needed. 0 keeps
// all hits.
float least_transmittance;

// Slots of the hits of a filled buffer, sorted from near to far.
uint hit_place[SLOTS];

Hit placed_hit(uint place) {
    return Hit(placed_t[place], placed_alpha[place], placed_instance[place], placed_surfel[place]);
}
Key placed_key(uint place) { return Key(placed_t[place], placed_instance[place], placed_surfel[place]); }

/// Returns hit i of the filled buffer. Hit 0 is the nearest hit.
Hit hit_at(uint i) { return placed_hit(hit_place[i]); }
Key hit_key(uint i) { return placed_key(hit_place[i]); }

/// Writes a hit to a slot of the buffer.
void place_hit(uint place, Hit hit) {
    placed_t[place] = hit.t;
    placed_alpha[place] = hit.alpha;
    placed_instance[place] = hit.instance;
    placed_surfel[place] = hit.surfel;
}

/// Appends a hit that is farther than all hits in the buffer.
void append_hit(Hit hit) {
    place_hit(n_hits, hit);
    hit_place[n_hits] = n_hits;
    ++n_hits;
}

/// Writes the slots of a filled buffer to hit_place, from near to far.
void order_hits() {
    uint place = next_nearer[CHUNK];
    for (uint i = n_hits; i > 0u; --i) {
        hit_place[i - 1u] = place;
        place = next_nearer[place];
    }
}

/// Removes the farthest hit from the buffer.
/// @param left  transmittance of the remaining hits
/// @return slot of the removed hit
uint drop_farthest(float left) {
    uint place = next_nearer[CHUNK];
    next_nearer[CHUNK] = next_nearer[place];
    hits_transmittance = left;
    if (place == latest) latest_t = -kFar;
    --n_hits;
    return place;
}

/// Returns the transmittance of all hits in the buffer except the farthest hit.
float left_before_farthest(float alpha_max) {
    return hits_transmittance / (1.0 - min(placed_alpha[next_nearer[CHUNK]], alpha_max));
}

/// Removes the farthest hits if the nearer hits already reduce the transmittance below
/// T_min. Hits behind these cannot contribute.
void cut_by_transmittance(float alpha_max) {
    // Returns early in the usual case. Without this test a CPU would execute the loop
    // body once.
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

/// Returns a slot for a new hit: the slot of a removed hit, or an unused slot.
uint insertion_index(float alpha_max) {
    if (n_hits == CHUNK) return drop_farthest(left_before_farthest(alpha_max));
    uint place = free_place;
    if (place == CHUNK) return n_places++;
    free_place = next_nearer[place];
    return place;
}

/// Inserts a hit into the sorted buffer. Removes the farthest hit if the buffer is full.
void insert(Key key, float alpha, float alpha_max) {
    uint farther = key.t < latest_t ? latest : CHUNK, nearer = next_nearer[farther];
    for (;;) {
        float t = placed_t[nearer];
        if (!(t >= key.t)) break;
        if (t == key.t) {  // equal distances are rare
            Key present_key = placed_key(nearer);
            // Ignores a surfel that is already in the buffer. The ray also hit its other
            // triangle, or the driver reported its box twice.
            if (present_key == key) return;
            if (before(present_key, key)) break;
        }
        farther = nearer;
        nearer = next_nearer[nearer];
    }
    uint slot = insertion_index(alpha_max);
    // The new slot belonged to the farthest hit, which was removed, so the sentinel
    // replaces it as neighbour.
    if (slot == farther) farther = CHUNK;
    place_hit(slot, Hit(key.t, alpha, key.instance, key.surfel));
    latest = slot;
    latest_t = key.t;
    next_nearer[slot] = nearer;
    next_nearer[farther] = slot;
    ++n_hits;
    hits_transmittance *= 1.0 - min(alpha, alpha_max);
    if (n_hits == CHUNK) hits_closed = true;
    cut_by_transmittance(alpha_max);
    if (hits_closed) farthest_t = placed_t[next_nearer[CHUNK]];
}

/// Returns the distance of the farthest hit in the buffer. A closed buffer accepts no
/// hits behind it.
float last_hit_t() { return farthest_t; }

/// Returns true if a hit is too far away to contribute in this pass.
bool is_behind(Key key) {
    if (!hits_closed || key.t < farthest_t) return false;
    return key.t > farthest_t || !before(key, placed_key(next_nearer[CHUNK]));
}

void reset_hits(float least) {
    n_hits = 0u;
    n_places = 0u;
    free_place = CHUNK;
    placed_t[CHUNK] = -kFar;  // sentinel: nearer than any hit
    next_nearer[CHUNK] = CHUNK;
    latest_t = -kFar;
    hits_closed = false;
    hits_transmittance = 1.0;
    least_transmittance = least;
}
#endif
