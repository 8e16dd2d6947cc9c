// SPDX-License-Identifier: Apache-2.0
// The order of the hits of a ray, and where the hits of a list lie.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_KEYS_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_KEYS_GLSL

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

/// Entry of a hit of a list. 32 lists lie side by side: rays that run together write and read neighbouring addresses.
uint list_entry(HitLists lists, uint list, uint k) { return (((list >> 5u) * lists.room + k) << 5u) + (list & 31u); }
#endif
