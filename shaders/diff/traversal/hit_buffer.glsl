// SPDX-License-Identifier: Apache-2.0
// Buffer for the nearest hits of a ray. Each thread has one buffer with at most CHUNK
// hits. find_next_hits() fills the buffer and sorts it from near to far.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_BUFFER_GLSL
RELIDAR_CONSTANT(uint, CHUNK, 16u);

// During the search, the buffer is a linked ring of at most CHUNK entries, ordered from
// the farthest hit to the nearest. Therefore inserting a hit does not move other hits.
// Entry CHUNK is a sentinel between the nearest and the farthest hit.
//
// The search for an insertion point starts at the farthest hit, because hits arrive
// roughly from near to far. If the new hit is nearer than the latest inserted hit, the
// search starts at the latest hit, because hits arrive in clusters.
const float kFarAway_m = 1e38;
float placed_t[SLOTS];
uint next_nearer[SLOTS];  // index of the next nearer hit
float placed_alpha[SLOTS];
uint placed_instance[SLOTS];
uint placed_surfel[SLOTS];
uint n_hits;
uint n_places;  // number of entries used so far
// First free entry of the buffer, whose hit was removed. The free entries form a linked
// list, and new hits reuse them. CHUNK means that the list is empty.
uint free_place;
uint latest;       // index of the hit that was inserted last
float latest_t;    // Distance of the hit that was inserted last. It is -kFarAway_m if that hit was removed.
float farthest_t;  // distance of the farthest hit, valid if hits_closed is true
// True if hits behind the farthest stored hit can be ignored. This is the case if the
// buffer is full, or if the ray ends at the farthest stored hit.
bool hits_closed;
float hits_transmittance;  // product of 1 - alpha over all hits in the buffer
// Transmittance at which the ray ends, so that hits behind are not needed. 0 = all hits
// are needed.
float least_transmittance;

// Indices of the stored hits, sorted from near to far at the end of the search.
uint hit_place[SLOTS];

Hit load_sorted_hit(uint place) {
    return Hit(placed_t[place], placed_alpha[place], placed_instance[place], placed_surfel[place]);
}
HitKey load_sorted_key(uint place) {
    return HitKey(placed_t[place], placed_instance[place], placed_surfel[place]);
}

/// Returns hit `index` of the sorted buffer. Hit 0 is the nearest hit.
Hit load_hit(uint index) { return load_sorted_hit(hit_place[index]); }
HitKey load_hit_key(uint index) { return load_sorted_key(hit_place[index]); }

void write_hit(uint place, Hit hit) {
    placed_t[place] = hit.t;
    placed_alpha[place] = hit.alpha;
    placed_instance[place] = hit.instance;
    placed_surfel[place] = hit.surfel;
}

/// Appends a hit that is farther than all hits in the buffer.
void append_hit(Hit hit) {
    write_hit(n_hits, hit);
    hit_place[n_hits] = n_hits;
    ++n_hits;
}

/// Writes the indices of the stored hits to hit_place, from near to far.
void sort_hits() {
    uint place = next_nearer[CHUNK];
    for (uint i = n_hits; i > 0u; --i) {
        hit_place[i - 1u] = place;
        place = next_nearer[place];
    }
}

/// Removes the farthest hit from the buffer.
/// @param remaining_transmittance product of 1 - alpha over the remaining hits
/// @return index of the entry that is free now
uint remove_farthest(float remaining_transmittance) {
    uint place = next_nearer[CHUNK];
    next_nearer[CHUNK] = next_nearer[place];
    hits_transmittance = remaining_transmittance;
    if (place == latest) latest_t = -kFarAway_m;
    --n_hits;
    return place;
}

/// Returns the transmittance of the ray just before its farthest stored hit.
float last_transmittance(float alpha_max) {
    return hits_transmittance / (1.0 - min(placed_alpha[next_nearer[CHUNK]], alpha_max));
}

/// Removes far hits that cannot contribute, because nearer hits reduce the transmittance
/// below the limit.
void drop_invisible(float alpha_max) {
    // Usually no hit must be removed, so this line returns. Without it, a CPU would
    // execute the first iteration of the loop below, even if no thread needs the loop.
    if (!(hits_transmittance < least_transmittance)) return;
    while (n_hits > 1u) {
        float left = last_transmittance(alpha_max);
        if (!(left < least_transmittance)) return;
        uint place = remove_farthest(left);
        next_nearer[place] = free_place;
        free_place = place;
        hits_closed = true;
    }
}

/// Returns the buffer entry for a new hit: a free entry, or the entry of the farthest hit
/// if the buffer is full.
uint allocate_hit(float alpha_max) {
    if (n_hits == CHUNK) return remove_farthest(last_transmittance(alpha_max));
    uint place = free_place;
    if (place == CHUNK) return n_places++;
    free_place = next_nearer[place];
    return place;
}

/// Inserts a hit into the ordered buffer. If the buffer is full, removes the farthest hit
/// first.
void insert_hit(HitKey key, float alpha, float alpha_max) {
    uint farther = key.t < latest_t ? latest : CHUNK, nearer = next_nearer[farther];
    for (;;) {
        float t = placed_t[nearer];
        if (!(t >= key.t)) break;
        if (t == key.t) {  // hits at equal distances are rare
            HitKey present_key = load_sorted_key(nearer);
            // Ignores a hit that is already in the buffer. Hits arrive twice if the ray
            // crosses two triangles around a surfel, or if the driver reports a box
            // twice.
            if (present_key == key) return;
            if (is_key_before(present_key, key)) break;
        }
        farther = nearer;
        nearer = next_nearer[nearer];
    }
    uint slot = allocate_hit(alpha_max);
    // `farther` is the entry behind the new hit. If the buffer was full, this entry may
    // just have been freed for the new hit. Then the new hit is the farthest one, and
    // `farther` becomes CHUNK, the sentinel entry of the list.
    if (slot == farther) farther = CHUNK;
    write_hit(slot, Hit(key.t, alpha, key.instance, key.surfel));
    latest = slot;
    latest_t = key.t;
    next_nearer[slot] = nearer;
    next_nearer[farther] = slot;
    ++n_hits;
    hits_transmittance *= 1.0 - min(alpha, alpha_max);
    if (n_hits == CHUNK) hits_closed = true;
    drop_invisible(alpha_max);
    if (hits_closed) farthest_t = placed_t[next_nearer[CHUNK]];
}

/// Returns the distance of the farthest stored hit. Valid only if hits_closed is true,
/// which means that the search ignores hits behind this distance.
float last_hit_t() { return farthest_t; }

/// Returns true if a hit is not needed because it is behind the farthest needed hit.
bool is_behind_last(HitKey key) {
    if (!hits_closed || key.t < farthest_t) return false;
    return key.t > farthest_t || !is_key_before(key, load_sorted_key(next_nearer[CHUNK]));
}

/// Removes all hits. Hits are not needed if the transmittance before them is below
/// `cutoff_transmittance`. 0 means that all hits are needed.
void reset_hits(float cutoff_transmittance) {
    n_hits = 0u;
    n_places = 0u;
    free_place = CHUNK;
    placed_t[CHUNK] = -kFarAway_m;  // sentinel, nearer than any hit
    next_nearer[CHUNK] = CHUNK;
    latest_t = -kFarAway_m;
    hits_closed = false;
    hits_transmittance = 1.0;
    least_transmittance = cutoff_transmittance;
}
#endif
