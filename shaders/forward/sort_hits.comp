// SPDX-License-Identifier: Apache-2.0
// Puts the hits of each list in the order of their keys (t, instance, surfel), and leaves out those that lie behind the end of the ray.
// A subgroup sorts a list; its lanes hold the hits. Hits are parted by distance into as many stretches as there are hits, about; those of
// one are counted before each other. A list's stretches, summed from the nearest, also tell behind which the ray has ended:
//   sum of -log2(1 - alpha) >= -log2(T_min),   of whole numbers, rounded down.
// In and output: lists.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "../common/kernel.glsl"
#include "../shared/trace.h"
#include "../traversal/keys.glsl"
RELIDAR_PARAMS(SortHitsParams);

RELIDAR_CONSTANT(uint, ROOM, 64u);
RELIDAR_CONSTANT(uint, LANES, 32u);

const uint LISTS = RELIDAR_SORTED_TOGETHER;   // subgroups of a workgroup, which are full
const uint STRETCHES = 128u;                  // at most
const uint FEW = 64u;                         // hits, for which a quarter of them is enough
const uint HELD = (ROOM + LANES - 1u) / LANES;   // hits of a lane
shared float t_of[LISTS * ROOM];       // stretch by stretch
shared uint entry_of[LISTS * ROOM];    // which of the list they are
shared uint first_of[LISTS * STRETCHES];
shared uint count_of[LISTS * STRETCHES];
shared uint depth_of[LISTS * STRETCHES];   // sum of -log2(1 - alpha)

/// Of some hits side by side in shared memory those before one of them; of hits that were reported twice one is.
/// @param slot  where that one lies @param begin @param end  of its stretch
uint n_before(uint list, uint slot, uint begin, uint end, Hit hit) {
    uint n_nearer = 0u, n_equal = 0u;
    for (uint j = begin; j < end; ++j) {
        float t = t_of[j];
        if (t < hit.t) ++n_nearer;
        if (t == hit.t) ++n_equal;
    }
    if (n_equal < 2u) return n_nearer;
    Key key = Key(hit.t, hit.instance, hit.surfel);
    for (uint j = begin; j < end; ++j) {
        if (t_of[j] != hit.t || j == slot) continue;
        Hit other = params.lists.hits.at[list_entry(params.lists.room, list, entry_of[j])];
        Key other_key = Key(other.t, other.instance, other.surfel);
        if (before(other_key, key) || (other_key == key && j < slot)) ++n_nearer;
    }
    return n_nearer;
}

void main() {
    uint list = workgroup_index() * LISTS + gl_SubgroupID, lane = gl_SubgroupInvocationID;
    uint length = list < params.lists.n ? params.lists.lengths.at[list] : 0u, n = length & ~RELIDAR_LIST_CLOSED;
    if (length == RELIDAR_LIST_UNFIT || n < 2u) n = 0u;   // and no return: lavapipe takes a barrier of a subgroup for one of the workgroup
    const uint n_stretches = n <= FEW ? max(STRETCHES / 4u, LANES) : STRETCHES, stretches = gl_SubgroupID * STRETCHES,
               slots = gl_SubgroupID * ROOM;
    for (uint s = lane; s < n_stretches; s += LANES) {
        count_of[stretches + s] = 0u;
        depth_of[stretches + s] = 0u;
    }
    Hit held[HELD];
    float nearest = 1e38, farthest = -1e38;
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n) {
            held[h] = params.lists.hits.at[list_entry(params.lists.room, list, h * LANES + lane)];
            nearest = min(nearest, held[h].t);
            farthest = max(farthest, held[h].t);
        }
    nearest = subgroupMin(nearest);
    farthest = subgroupMax(farthest);
    const float per_m = farthest > nearest ? float(n_stretches) / (farthest - nearest) : 0.0;
    subgroupBarrier();
    uint place[HELD];   // first stretch, and which of it; then in the list
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n) {
            uint s = min(uint((held[h].t - nearest) * per_m), n_stretches - 1u);   // of a farther hit never less
            float left = 1.0 - min(held[h].alpha, params.alpha_max);
            place[h] = s | atomicAdd(count_of[stretches + s], 1u) << 16u;
            atomicAdd(depth_of[stretches + s], uint(-RELIDAR_DEPTH_UNIT * log2(max(left, 1e-30))));
        }
    subgroupBarrier();
    uint n_kept = n, n_first = 0u, depth = 0u;
    for (uint s = lane; s < n_stretches; s += LANES) {
        uint count = count_of[stretches + s], up_to = n_first + subgroupInclusiveAdd(count);
        first_of[stretches + s] = up_to - count;
        uint depth_up_to = depth + subgroupInclusiveAdd(depth_of[stretches + s]);
        n_kept = subgroupMin(depth_up_to >= params.opaque ? min(up_to, n_kept) : n_kept);
        n_first = subgroupMax(up_to);
        depth = subgroupMax(depth_up_to);
    }
    subgroupBarrier();
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n) {
            uint slot = slots + first_of[stretches + (place[h] & 0xffffu)] + (place[h] >> 16u);
            t_of[slot] = held[h].t;
            entry_of[slot] = h * LANES + lane;
        }
    subgroupBarrier();
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n) {
            uint s = stretches + (place[h] & 0xffffu), first = first_of[s], slot = first + (place[h] >> 16u);
            place[h] = first;
            if (first < n_kept) place[h] += n_before(list, slots + slot, slots + first, slots + first + count_of[s], held[h]);
        }
    subgroupBarrier();
    [[unroll]] for (uint h = 0u; h < HELD; ++h)
        if (h * LANES + lane < n && place[h] < n_kept) params.lists.hits.at[list_entry(params.lists.room, list, place[h])] = held[h];
    if (lane == 0u && n_kept < n) params.lists.lengths.at[list] = n_kept | RELIDAR_LIST_CLOSED;
}
