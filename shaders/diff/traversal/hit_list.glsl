// SPDX-License-Identifier: Apache-2.0
// Where next_hits() puts what a ray meets in a kernel that appends: the ray's list in
// memory, in the order in which they are found. An ordered buffer costs a GPU more than
// the search; forward/sort_hits puts a list in order afterwards.
//
// No hit is lost: once the product of 1 - alpha over a set of hits is under T_min,
// whatever their order, so is that over all hits up to the farthest of them, and the ray
// ends before it or there. The hits found after that, all nearer, are the next such set:
// they draw the end nearer where the search met something far away first. A hit that a
// driver reports twice counts twice, so that a list may be closed too early:
// forward/blend then finds that its ray has not ended, and leaves it to forward/trace.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL

HitLists listed;  // those of the launch
uint own_list;
uint n_hits;       // found so far; those behind the room of the list are not in it
bool hits_closed;  // nothing behind end_t can matter any more
float end_t;
float set_transmittance;    // product of 1 - alpha over the hits since the list was closed
float least_transmittance;  // of a set that closes nothing
float farthest_t;           // of the set

/// Where the last hit lies that can matter, behind which a closed list takes none.
float last_hit_t() { return end_t; }

/// Whether a hit can not matter any more.
bool is_behind(Key key) { return hits_closed && key.t > end_t; }

/// Share of the light that is taken for left by a report of a hit.
float left_by(float alpha) {
#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
    // reported where the ray enters it, and where it leaves it
    if (proxy_triangles() == kProxy_icosahedron) return sqrt(1.0 - alpha);
#endif
    return 1.0 - alpha;
}

/// Appends a hit to the list.
void insert(Key key, float alpha, float alpha_max) {
    uint slot = n_hits++;
    if (slot >= listed.room) {  // forward/trace renders this ray
        hits_closed = true;
        end_t = 0.0;
        return;
    }
    listed.hits.at[list_entry(listed.room, own_list, slot)] = Hit(key.t, alpha, key.instance, key.surfel);
    farthest_t = max(farthest_t, key.t);
    set_transmittance *= left_by(min(alpha, alpha_max));
    if (set_transmittance < least_transmittance) {
        hits_closed = true;
        end_t = farthest_t;
        set_transmittance = 1.0;
        farthest_t = 0.0;
    }
}

/// forward/sort_hits does.
void order_hits() {}

void reset_hits(float least) {
    n_hits = 0u;
    hits_closed = false;
    end_t = 0.0;
    set_transmittance = 1.0;
    least_transmittance = least;
    farthest_t = 0.0;
}
#endif
