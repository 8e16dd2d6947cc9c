// SPDX-License-Identifier: Apache-2.0
// Defines the sort order of the hits of a ray and the memory layout of hit lists.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL

struct Key {
    float t;
    uint instance;
    uint surfel;
};

bool is_key_before(Key first, Key second) {
    if (first.t != second.t) return first.t < second.t;
    if (first.instance != second.instance) return first.instance < second.instance;
    return first.surfel < second.surfel;
}

/// Returns the array index of hit `index` in a ray's hit list, which has the number
/// `list`. The hits of RELIDAR_SIDE_BY_SIDE (2) lists alternate in memory, for speed.
/// @param capacity maximum number of hits in a list
uint get_list_entry(uint capacity, uint list, uint index) {
    return ((list / RELIDAR_SIDE_BY_SIDE) * capacity + index) * RELIDAR_SIDE_BY_SIDE +
           list % RELIDAR_SIDE_BY_SIDE;
}
#endif
