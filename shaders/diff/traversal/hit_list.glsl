// SPDX-License-Identifier: Apache-2.0
// List of the hits of a ray in global memory, which replaces the ordered hit buffer in
// some kernels. The list is not ordered; kernel forward/sort_hits sorts it afterwards.
//
// The search shortens the ray, but never loses a hit that contributes. If the product of
// 1 - alpha over a set of hits is below T_min, the ray ends at the farthest hit of the
// set or before it. Then the product starts again with the following hits, which are all
// nearer.
//
// If a driver reports a hit twice, the ray may be shortened too much. Kernel
// forward/blend detects such a ray because its transmittance has not reached the limit,
// and forward/trace renders it.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_HIT_LIST_GLSL

HitLists listed;  // hit lists of all threads of the launch
uint list_index;
uint n_hits;       // Number of hits of the ray so far, including hits that do not fit into the list.
bool hits_closed;  // True if hits behind the distance end_t cannot contribute.
float end_t;
// Product of 1 - alpha over the latest hits. Each time that insert_hit() shortens the ray
// (sets end_t), it restarts this product at 1.
float set_transmittance;
// If set_transmittance falls below this limit, insert_hit() ends the ray at farthest_t.
float least_transmittance;
float farthest_t;  // Distance of the farthest hit since end_t was last set.

/// Returns the distance `end_t` at which insert_hit() has ended the ray. Farther hits
/// cannot contribute. Valid only if hits_closed is true, otherwise the ray has no end
/// yet.
float last_hit_t() { return end_t; }

/// Returns true if a hit is behind the end of the ray, so that it cannot contribute.
bool is_behind_last(HitKey key) { return hits_closed && key.t > end_t; }

/// Returns the factor by which set_transmittance is multiplied when a hit is reported. It
/// is 1 - alpha, unless the driver reports each hit twice.
float transmittance_factor(float alpha) {
#ifdef RELIDAR_TRAVERSAL_RAY_QUERY
    // The driver reports a hit on an icosahedron twice: where the ray enters and where it
    // leaves. The product of two factors sqrt(1 - alpha) is 1 - alpha.
    if (proxy_triangles() == kProxy_icosahedron) return sqrt(1.0 - alpha);
#endif
    return 1.0 - alpha;
}

/// Appends a hit to the list. Ends the ray at the farthest hit so far when these hits
/// absorb enough light.
void insert_hit(HitKey key, float alpha, float alpha_max) {
    uint slot = n_hits++;
    if (slot >= listed.room) {  // The list is full, so kernel forward/trace must render this ray.
        hits_closed = true;
        end_t = 0.0;
        return;
    }
    listed.hits.at[hit_list_index(listed.room, list_index, slot)] =
        Hit(key.t, alpha, key.instance, key.surfel);
    farthest_t = max(farthest_t, key.t);
    set_transmittance *= transmittance_factor(min(alpha, alpha_max));
    if (set_transmittance < least_transmittance) {
        hits_closed = true;
        end_t = farthest_t;
        set_transmittance = 1.0;
        farthest_t = 0.0;
    }
}

/// Does nothing, because kernel forward/sort_hits sorts the list later.
void sort_hits() {}

void reset_hits(float cutoff_transmittance) {
    n_hits = 0u;
    hits_closed = false;
    end_t = 0.0;
    set_transmittance = 1.0;
    least_transmittance = cutoff_transmittance;
    farthest_t = 0.0;
}
#endif
