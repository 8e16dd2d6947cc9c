// SPDX-License-Identifier: Apache-2.0
// Sorts each hit list by (t, instance, surfel) with a bitonic sorting network in
// registers. One subgroup sorts one list. Each lane holds 1 to 16 consecutive hits,
// depending on the length of the list. The network sorts only distances and positions.
// Then the subgroup moves the hits to their sorted positions. In place: lists.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/trace.h"
#include "../traversal/keys.glsl"
RELIDAR_PARAMS(SortHitsParams);

RELIDAR_CONSTANT(uint, LANES, 32u);

Hit load_list_hit(uint list, uint place) {
    return params.lists.hits.at[hit_list_index(params.lists.room, list, place)];
}

/// Compares two hits at the same distance, given by their positions `first_position` and
/// `second_position` in the list. Returns true if `first_position` comes before
/// `second_position`, ordered by instance, then surfel, then position. Positions beyond
/// the end of the list come last.
bool is_before(uint list, uint hit_count, uint first_position, uint second_position) {
    if (first_position >= hit_count || second_position >= hit_count) return first_position < second_position;
    Hit hit_a = load_list_hit(list, first_position), hit_b = load_list_hit(list, second_position);
    HitKey key_a = HitKey(hit_a.t, hit_a.instance, hit_a.surfel),
           key_b = HitKey(hit_b.t, hit_b.instance, hit_b.surfel);
    return is_key_before(key_a, key_b) || (key_a == key_b && first_position < second_position);
}

// Macros that unroll the loops over the hits of a lane, with a separate sort function for
// each number of hits. In a normal loop, compilers may store the hits in memory instead
// of registers, which is slower.
#define EACH_OF_1(X, h) X((h))
#define EACH_OF_2(X, h) EACH_OF_1(X, h) EACH_OF_1(X, h + 1u)
#define EACH_OF_4(X, h) EACH_OF_2(X, h) EACH_OF_2(X, h + 2u)
#define EACH_OF_8(X, h) EACH_OF_4(X, h) EACH_OF_4(X, h + 4u)
#define EACH_OF_16(X, h) EACH_OF_8(X, h) EACH_OF_8(X, h + 8u)

#define HELD 1
#define EACH(X) EACH_OF_1(X, 0u)
#define SORT_HITS_OF_LIST sort_1
#include "sort_held.glsl"
#define HELD 2
#define EACH(X) EACH_OF_2(X, 0u)
#define SORT_HITS_OF_LIST sort_2
#include "sort_held.glsl"
#define HELD 4
#define EACH(X) EACH_OF_4(X, 0u)
#define SORT_HITS_OF_LIST sort_4
#include "sort_held.glsl"
#define HELD 8
#define EACH(X) EACH_OF_8(X, 0u)
#define SORT_HITS_OF_LIST sort_8
#include "sort_held.glsl"
#define HELD 16  // must equal RELIDAR_MOST_HELD in shared/trace.h
#define EACH(X) EACH_OF_16(X, 0u)
#define SORT_HITS_OF_LIST sort_16
#include "sort_held.glsl"

void main() {
    // correct only because all subgroups are full
    uint list = workgroup_index() * RELIDAR_SORTED_TOGETHER + gl_SubgroupID;
    uint length = list < params.lists.n ? params.lists.lengths.at[list] : 0u,
         n = length & ~RELIDAR_LIST_CLOSED;
    // On lavapipe, a subgroup barrier waits for all subgroups of the workgroup. The sort
    // functions contain one barrier. Therefore subgroups that do not sort need a barrier
    // too.
    if (length == RELIDAR_LIST_UNFIT || n < 2u) subgroupBarrier();
    else if (n <= LANES) sort_1(list, n);
    else if (n <= 2u * LANES) sort_2(list, n);
    else if (n <= 4u * LANES) sort_4(list, n);
    else if (n <= 8u * LANES || 8u * LANES >= RELIDAR_MOST_ROOM) sort_8(list, n);
    else sort_16(list, n);
}
