// SPDX-License-Identifier: Apache-2.0
// Radix sort, last of three kernels a pass: moves each key behind all smaller digits and the equal digits before it. A workgroup of
// 256 threads a tile of 4096 keys; each subgroup owns a run of the tile and ranks it round by round with ballots, so that the order
// of equal digits is kept. Input: keys, values, counts, totals. Output: sorted keys and values. Floor: 12 B read, 12 B written a key.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../common/workgroup_scan.glsl"
#include "bvh_sort.glsl"
#extension GL_KHR_shader_subgroup_ballot : require
RELIDAR_PARAMS(BvhSortParams);

const uint ROUNDS = RELIDAR_BVH_TILE / RELIDAR_BVH_WORKGROUP;
const uint WORDS = RELIDAR_SORT_DIGITS / 2u;   // two 16-bit counts each: a tile has fewer than 65536 keys
shared uint counters[32u * WORDS];             // keys of a digit in the run of a subgroup; then in the runs before
shared uint digit_start[RELIDAR_SORT_DIGITS];  // where the keys of this tile start

uint half_word(uint word, uint digit) { return (word >> (16u * (digit & 1u))) & 0xffffu; }

/// Lanes of the subgroup that hold the same digit; lanes without a key agree among themselves.
uvec2 peers_of(bool valid, uint digit) {
    uvec2 with_key = subgroupBallot(valid).xy;
    uvec2 peers = valid ? with_key : ~with_key;
    for (uint bit = 1u; bit < RELIDAR_SORT_DIGITS; bit <<= 1) {
        bool set = (digit & bit) != 0u;
        uvec2 lanes = subgroupBallot(set).xy;
        peers &= set ? lanes : ~lanes;
    }
    return peers;
}

void main() {
    uint tile = workgroup_index(), thread = scan_thread();
    uint counter = gl_SubgroupID * WORDS;
    uint run = tile * RELIDAR_BVH_TILE + gl_SubgroupID * gl_SubgroupSize * ROUNDS + gl_SubgroupInvocationID;
    uvec2 unused;
    digit_start[thread] = workgroup_exclusive_add(uvec2(params.totals.at[thread], 0u), unused).x +
                          (tile < params.n_tiles ? params.counts.at[thread * params.n_tiles + tile] : 0u);
    for (uint i = thread; i < gl_NumSubgroups * WORDS; i += RELIDAR_BVH_WORKGROUP) counters[i] = 0u;
    barrier();
    uint rank[ROUNDS];
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        bool valid = i < params.n;
        uint digit = valid ? digit_of(params.keys.at[i], params.shift) : 0u;
        uvec2 peers = peers_of(valid, digit), before = peers & gl_SubgroupLtMask.xy;
        uint smaller = bitCount(before.x) + bitCount(before.y);
        rank[r] = half_word(counters[counter + digit / 2u], digit) + smaller;
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        if (valid && smaller == 0u) atomicAdd(counters[counter + digit / 2u], (bitCount(peers.x) + bitCount(peers.y)) << (16u * (digit & 1u)));
        subgroupMemoryBarrierShared();
        subgroupBarrier();
    }
    barrier();
    if (thread < WORDS) {
        uint sum = 0u;
        for (uint at = thread; at < gl_NumSubgroups * WORDS; at += WORDS) {
            uint word = counters[at];
            counters[at] = sum;
            sum += word;
        }
    }
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        if (i >= params.n) continue;
        uvec2 key = params.keys.at[i];
        uint digit = digit_of(key, params.shift);
        uint to = digit_start[digit] + half_word(counters[counter + digit / 2u], digit) + rank[r];
        params.sorted_keys.at[to] = key;
        params.sorted_values.at[to] = params.values.at[i];
    }
}
