// SPDX-License-Identifier: Apache-2.0
// Defines the sort order of the hits of a ray and the memory layout of hit lists.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL

struct HitKey {
    float t;
    uint instance;
    uint surfel;
};

bool is_key_before(HitKey first, HitKey second) {
    if (first.t != second.t) return first.t < second.t;
    if (first.instance != second.instance) return first.instance < second.instance;
    return first.surfel < second.surfel;
}

/// Returns the array index of hit number `hit` of a ray's hit list, which has the number
/// `list`. The hits of RELIDAR_SIDE_BY_SIDE (2) lists alternate in memory, for speed.
/// @param hits_per_list maximum number of hits in a list
uint hit_list_index(uint hits_per_list, uint list, uint hit) {
    return ((list / RELIDAR_SIDE_BY_SIDE) * hits_per_list + hit) * RELIDAR_SIDE_BY_SIDE +
           list % RELIDAR_SIDE_BY_SIDE;
}
#endif
