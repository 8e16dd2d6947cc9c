// SPDX-License-Identifier: Apache-2.0
// The order of the hits of a ray, and where the hits of a list lie, or those that are
// kept of a ray.
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

/// Entry of a hit of a list that has this room; a list is the thread's that traces its
/// ray. Few lists lie side by side: so both the threads that walk along one list each and
/// the lanes that read one list together touch whole sectors of a cache.
uint list_entry(uint room, uint list, uint k) {
    return ((list / RELIDAR_SIDE_BY_SIDE) * room + k) * RELIDAR_SIDE_BY_SIDE + list % RELIDAR_SIDE_BY_SIDE;
}
#endif
