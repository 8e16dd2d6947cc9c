// SPDX-License-Identifier: Apache-2.0
// Defines the sort order of the hits of a ray and the memory layout of hit lists.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_KEYS_GLSL

struct Key {
    float t;
    uint instance;
    uint surfel;
};

bool before(Key a, Key b) {
    if (a.t != b.t) return a.t < b.t;
    if (a.instance != b.instance) return a.instance < b.instance;
    return a.surfel < b.surfel;
}

/// Returns the index in memory of hit k of a thread's hit list. `room` is the capacity of
/// a list. RELIDAR_SIDE_BY_SIDE lists are interleaved, so that reads use complete cache
/// sectors. This is true if each lane reads a separate list, and also if all lanes read
/// one list together.
uint list_entry(uint room, uint list, uint k) {
    return ((list / RELIDAR_SIDE_BY_SIDE) * room + k) * RELIDAR_SIDE_BY_SIDE + list % RELIDAR_SIDE_BY_SIDE;
}
#endif
