// SPDX-License-Identifier: Apache-2.0
// Hit buffer that next_hits() fills. Each thread has one. It holds the nearest CHUNK hits
// of the ray in order.
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
uint n_places;     // slots used so far
uint free_place;   // first free slot of a dropped hit, CHUNK if none; next_nearer links the free slots
uint latest;       // slot of the hit that was inserted last
float latest_t;    // -kFar if that hit was dropped
float farthest_t;  // distance of the farthest hit, if hits_closed
bool hits_closed;  // hits beyond the last one cannot contribute in this pass, so the search may end there
float hits_transmittance;  // product of 1 - alpha over the buffer
// below this transmittance, hits farther away cannot be blended; 0: keep all hits
float least_transmittance;

// Slots of a filled buffer in the order of the hits' keys, nearest first.
uint hit_place[SLOTS];

Hit placed_hit(uint place) {
    return Hit(placed_t[place], placed_alpha[place], placed_instance[place], placed_surfel[place]);
}
Key placed_key(uint place) { return Key(placed_t[place], placed_instance[place], placed_surfel[place]); }

/// Returns hit i of the filled buffer. Hit 0 is the nearest.
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

/// Writes the slots of a filled ring to hit_place in order.
void order_hits() {
    uint place = next_nearer[CHUNK];
    for (uint i = n_hits; i > 0u; --i) {
        hit_place[i - 1u] = place;
        place = next_nearer[place];
    }
}

/// Removes the farthest hit.
/// @param left  transmittance of the other hits
/// @return slot of the removed hit
uint drop_farthest(float left) {
    uint place = next_nearer[CHUNK];
    next_nearer[CHUNK] = next_nearer[place];
    hits_transmittance = left;
    if (place == latest) latest_t = -kFar;
    --n_hits;
    return place;
}

/// Returns the transmittance of all hits except the farthest.
float left_before_farthest(float alpha_max) {
    return hits_transmittance / (1.0 - min(placed_alpha[next_nearer[CHUNK]], alpha_max));
}

/// Drops the farthest hits while the nearer hits alone end the ray. Their transmittance
/// is then below T_min, so hits behind them cannot matter.
void cut_by_transmittance(float alpha_max) {
    // The usual case. Without this test a CPU would run through the loop once.
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

/// Returns a slot for a hit: the slot of a dropped hit, or a new slot.
uint take_place(float alpha_max) {
    if (n_hits == CHUNK) return drop_farthest(left_before_farthest(alpha_max));
    uint place = free_place;
    if (place == CHUNK) return n_places++;
    free_place = next_nearer[place];
    return place;
}

/// Inserts a hit into the buffer. Drops the farthest hit if the buffer is full.
void insert(Key key, float alpha, float alpha_max) {
    uint farther = key.t < latest_t ? latest : CHUNK, nearer = next_nearer[farther];
    for (;;) {
        float t = placed_t[nearer];
        if (!(t >= key.t)) break;
        if (t == key.t) {  // equal distances are rare
            Key present_key = placed_key(nearer);
            // The surfel is in the buffer already, because the ray also hit its other
            // triangle or the driver reported its box twice.
            if (present_key == key) return;
            if (before(present_key, key)) break;
        }
        farther = nearer;
        nearer = next_nearer[nearer];
    }
    uint slot = take_place(alpha_max);
    if (slot == farther) farther = CHUNK;  // the slot belonged to the farthest hit, which was dropped
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

/// Returns the distance of the last hit. A closed buffer accepts no hits behind it.
float last_hit_t() { return farthest_t; }

/// Returns true if a hit cannot contribute in this pass any more.
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
