// SPDX-License-Identifier: Apache-2.0
// Puts the hits of each list in the order of their keys (t, instance, surfel). Each hit goes to the place that is the number of hits before
// it: for some dozens of hits counting is cheaper than exchanging them, and its steps do not wait for each other. A subgroup sorts a list;
// its lanes hold the hits, and their distances lie in shared memory.
// In and output: lists.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_vote : require
#include "../common/kernel.glsl"
#include "../shared/trace.h"
#include "../traversal/keys.glsl"
RELIDAR_PARAMS(SortHitsParams);

RELIDAR_CONSTANT(uint, ROOM, 64u);
RELIDAR_CONSTANT(uint, LANES, 32u);

const uint LISTS = RELIDAR_SORTED_TOGETHER;   // subgroups of a workgroup, which are full
const uint PITCH = (ROOM + 3u) & ~3u;
const uint HELD = (ROOM + LANES - 1u) / LANES;   // hits of a lane
shared float t_of[LISTS * PITCH];
shared uint n_at[LISTS * PITCH];   // hits that go to a place: more than one where distances are equal

/// Hits of the list that are at the same distance and before this one by the rest of their keys; of hits that were reported twice one is.
uint equal_before(uint list, uint first, uint n, uint own, Hit hit) {
    uint n_before = 0u;
    Key key = Key(hit.t, hit.instance, hit.surfel);
    for (uint j = 0u; j < n; ++j) {
        if (t_of[first + j] != hit.t || j == own) continue;
        Hit other = params.lists.hits.at[list_entry(params.lists.room, list, j)];
        Key other_key = Key(other.t, other.instance, other.surfel);
        if (before(other_key, key) || (other_key == key && j < own)) ++n_before;
    }
    return n_before;
}

void main() {
    uint list = workgroup_index() * LISTS + gl_SubgroupID, first = gl_SubgroupID * PITCH, lane = gl_SubgroupInvocationID;
    uint length = list < params.lists.n ? params.lists.lengths.at[list] : 0u, n = length & ~RELIDAR_LIST_CLOSED;
    if (length == RELIDAR_LIST_UNFIT || n < 2u) n = 0u;   // and no return: lavapipe takes a barrier of a subgroup for one of the workgroup
    Hit held[HELD];
    uint place[HELD];
    [[unroll]] for (uint h = 0u; h < HELD; ++h) {
        uint k = h * LANES + lane;
        held[h].t = 1e38;
        if (k < n) {
            held[h] = params.lists.hits.at[list_entry(params.lists.room, list, k)];
            n_at[first + k] = 0u;
        }
        if (k < ((n + 3u) & ~3u)) t_of[first + k] = held[h].t;   // by fours: what follows the hits is no hit
    }
    subgroupBarrier();
    bool is_shared = false;
    [[unroll]] for (uint h = 0u; h < HELD; h += 2u) {   // two at a time: what is read of the others serves both
        const uint next = min(h + 1u, HELD - 1u);
        if (h * LANES < n) {
            uint n_nearer = 0u, next_nearer = 0u;
            float t = held[h].t, next_t = held[next].t;
            for (uint j = first; j < first + n; j += 4u) {
                vec4 four = vec4(t_of[j], t_of[j + 1u], t_of[j + 2u], t_of[j + 3u]);
                [[unroll]] for (uint c = 0u; c < 4u; ++c) {
                    n_nearer += four[c] < t ? 1u : 0u;
                    next_nearer += four[c] < next_t ? 1u : 0u;
                }
            }
            place[h] = n_nearer;
            place[next] = next == h ? n_nearer : next_nearer;
            if (h * LANES + lane < n && atomicAdd(n_at[first + n_nearer], 1u) > 0u) is_shared = true;
            if (next != h && next * LANES + lane < n && atomicAdd(n_at[first + next_nearer], 1u) > 0u) is_shared = true;
        }
    }
    subgroupBarrier();
    if (subgroupAny(is_shared)) {
        [[unroll]] for (uint h = 0u; h < HELD; ++h)
            if (h * LANES + lane < n && n_at[first + place[h]] > 1u) place[h] += equal_before(list, first, n, h * LANES + lane, held[h]);
    }
    subgroupBarrier();
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n) params.lists.hits.at[list_entry(params.lists.room, list, place[h])] = held[h];
}
