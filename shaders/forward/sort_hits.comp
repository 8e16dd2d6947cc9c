// SPDX-License-Identifier: Apache-2.0
// Puts the hits of each list in the order of their keys (t, instance, surfel): a bitonic network in shared memory, in the form that always
// leaves the smaller one in front, so that what is behind the end never moves and lists of any length need no filling. Distances and
// places move, the rest of a hit when the order is known. One workgroup a list.
// In and output: lists.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/trace.h"
#include "../traversal/keys.glsl"
RELIDAR_PARAMS(SortHitsParams);

RELIDAR_CONSTANT(uint, ROOM, 64u);

shared float t_of[ROOM];           // in the order so far
shared uint place_of[ROOM];        // where the rest of the hit lies
shared float alpha_at[ROOM];
shared uint instance_at[ROOM];
shared uint surfel_at[ROOM];

Key key_of(uint k) { return Key(t_of[k], instance_at[place_of[k]], surfel_at[place_of[k]]); }

/// Exchanges two hits where the second one is nearer. Equal distances are rare: t alone is looked at as long as it decides.
void put_nearer_first(uint i, uint j, uint n) {
    if (j >= n) return;
    float t = t_of[i], other_t = t_of[j];
    if (t < other_t || (t == other_t && !before(key_of(j), key_of(i)))) return;
    uint place = place_of[i];
    t_of[i] = other_t;
    place_of[i] = place_of[j];
    t_of[j] = t;
    place_of[j] = place;
}

void sort_hits(uint n) {
    uint n_pairs = 1u << findMSB(n - 1u);   // half of the next power of two
    for (int bits = 0; 1u << bits < n; ++bits) {   // runs of 2^bits are in order
        uint run = 1u << bits;
        for (uint pair = gl_LocalInvocationID.x; pair < n_pairs; pair += gl_WorkGroupSize.x) {   // two runs, the second one mirrored
            uint start = pair >> bits << (bits + 1), k = pair & (run - 1u);
            put_nearer_first(start + k, start + 2u * run - 1u - k, n);
        }
        barrier();
        for (int shift = bits - 1; shift >= 0; --shift) {
            for (uint pair = gl_LocalInvocationID.x; pair < n_pairs; pair += gl_WorkGroupSize.x) {
                uint i = (pair >> shift << (shift + 1)) + (pair & ((1u << shift) - 1u));
                put_nearer_first(i, i + (1u << shift), n);
            }
            barrier();
        }
    }
}

void main() {
    uint list = workgroup_index();
    if (list >= params.lists.n) return;
    uint length = params.lists.lengths.at[list], n = length & ~RELIDAR_LIST_CLOSED;
    if (length == RELIDAR_LIST_UNFIT || n < 2u) return;
    for (uint k = gl_LocalInvocationID.x; k < n; k += gl_WorkGroupSize.x) {
        Hit hit = params.lists.hits.at[list_entry(params.lists, list, k)];
        t_of[k] = hit.t;
        place_of[k] = k;
        alpha_at[k] = hit.alpha;
        instance_at[k] = hit.instance;
        surfel_at[k] = hit.surfel;
    }
    barrier();
    sort_hits(n);
    for (uint k = gl_LocalInvocationID.x; k < n; k += gl_WorkGroupSize.x) {
        uint place = place_of[k];
        params.lists.hits.at[list_entry(params.lists, list, k)] = Hit(t_of[k], alpha_at[place], instance_at[place], surfel_at[place]);
    }
}
