// SPDX-License-Identifier: Apache-2.0
// Hit list that next_hits() fills in kernels that append. The hits are stored in global
// memory, unordered, because an ordered buffer costs a GPU more time than the search.
// Kernel forward/sort_hits sorts the list afterwards.
//
// No hit is lost. If the product of 1 - alpha over some set of hits is below T_min, the
// same holds for all hits up to the farthest of the set. So the ray ends at that hit or
// before it. The hits that arrive afterwards are nearer and form the next set, which can
// move the end of the ray nearer again. A hit that a driver reports twice counts twice,
// so the list may be closed too early. Kernel forward/blend detects that the ray has not
// ended, and leaves the ray to forward/trace.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL

HitLists listed;  // hit lists of the launch
uint list_index;
uint n_hits;       // Number of hits so far, including hits that do not fit into the list.
bool hits_closed;  // True if hits behind the distance end_t cannot contribute any more.
float end_t;
// Product of 1 - alpha over the hits since the far end of the list was last shortened.
float set_transmittance;
// Limit of the transmittance product. When the product falls below it, the far end of the
// list is shortened.
float least_transmittance;
float farthest_t;  // Distance of the farthest hit since the far end of the list was last shortened.

/// Returns the distance of the last hit that can contribute. Hits behind this distance
/// are not added to a closed list.
float last_hit_t() { return end_t; }

/// Returns true if a hit cannot contribute any more.
bool is_behind(Key key) { return hits_closed && key.t > end_t; }

/// Returns the factor by which one reported hit reduces the transmittance product.
float left_by(float alpha) {
#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
    // A driver reports an icosahedron twice: where the ray enters and where the ray
    // leaves. So each report counts half.
    if (proxy_triangles() == kProxy_icosahedron) return sqrt(1.0 - alpha);
#endif
    return 1.0 - alpha;
}

/// Appends a hit to the list.
void insert(Key key, float alpha, float alpha_max) {
    uint slot = n_hits++;
    if (slot >= listed.room) {  // The list is full, so forward/trace must render this ray.
        hits_closed = true;
        end_t = 0.0;
        return;
    }
    listed.hits.at[list_entry(listed.room, list_index, slot)] = Hit(key.t, alpha, key.instance, key.surfel);
    farthest_t = max(farthest_t, key.t);
    set_transmittance *= left_by(min(alpha, alpha_max));
    if (set_transmittance < least_transmittance) {
        hits_closed = true;
        end_t = farthest_t;
        set_transmittance = 1.0;
        farthest_t = 0.0;
    }
}

/// Does nothing, because kernel forward/sort_hits sorts the list.
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
