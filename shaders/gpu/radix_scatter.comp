// SPDX-License-Identifier: Apache-2.0
// Radix sort, last of three kernels a pass: moves each key behind all smaller digits and
// the equal digits before it. A workgroup of 256 threads a tile of 4096 keys; each
// subgroup owns a run of the tile and ranks it round by round with ballots, so that the
// order of equal digits is kept. Where there are more than 32 (of 4 lanes), two share
// their counters and take turns. Input: n_keys, keys, order, counts, totals. Output:
// sorted_keys, sorted_order. Floor: key and order read and written.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
#extension GL_KHR_shader_subgroup_ballot : require
RELIDAR_PARAMS(RadixSortParams);
#include "radix.glsl"

const uint ROUNDS = RELIDAR_TILE_SIZE / RELIDAR_TILE_THREADS;
const uint WORDS = RELIDAR_SORT_DIGITS / 2u;  // two 16-bit counts each: a tile has fewer than 65536 keys
const uint ROWS = 32u;                        // as many as 16 KiB hold
// a row a subgroup, or two: keys of a digit in their run; then in the runs before
shared uint counters[ROWS * WORDS];
shared uint digit_start[RELIDAR_SORT_DIGITS];  // where the keys of this tile start
uint rank[ROUNDS];                             // of this lane's keys, one a round

/// Subgroups of one row of counters, neighbours.
uint n_sharing() { return (gl_NumSubgroups + ROWS - 1u) / ROWS; }

uint half_word(uint word, uint digit) { return (word >> (16u * (digit & 1u))) & 0xffffu; }

/// Lanes of the subgroup that hold the same digit; lanes without a key agree among
/// themselves.
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

/// Ranks the subgroup's run among the keys of its row: keys of the same digit before
/// each. Counts them. Every subgroup must call it, for on lavapipe the barrier of one
/// waits for all.
/// @param run first key of this lane  @param n keys in all  @param row of counters
/// @param in_turn whether there is a run
void rank_run(uint run, uint n, uint row, bool in_turn) {
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        bool valid = in_turn && i < n;
        uint digit = valid ? digit_of(i) : 0u;
        uvec2 peers = peers_of(valid, digit), before = peers & gl_SubgroupLtMask.xy;
        uint smaller = bitCount(before.x) + bitCount(before.y);
        if (in_turn) rank[r] = half_word(counters[row + digit / 2u], digit) + smaller;
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        if (valid && smaller == 0u)
            atomicAdd(counters[row + digit / 2u], (bitCount(peers.x) + bitCount(peers.y))
                                                      << (16u * (digit & 1u)));
        subgroupMemoryBarrierShared();
        subgroupBarrier();
    }
}

/// Counts of the rows become those of the rows before.
void sum_counters(uint n_rows) {
    if (scan_thread() >= WORDS) return;
    uint sum = 0u;
    for (uint at = scan_thread(); at < n_rows * WORDS; at += WORDS) {
        uint word = counters[at];
        counters[at] = sum;
        sum += word;
    }
}

void main() {
    uint tile = workgroup_index(), thread = scan_thread(), n = n_keys();
    if (tile >= n_tiles()) return;
    uint sharing = n_sharing(), n_rows = gl_NumSubgroups / sharing, row = gl_SubgroupID / sharing * WORDS;
    uint run = tile * RELIDAR_TILE_SIZE + gl_SubgroupID * gl_SubgroupSize * ROUNDS + gl_SubgroupInvocationID;
    uvec2 unused;
    digit_start[thread] = workgroup_exclusive_add(uvec2(params.totals.at[thread], 0u), unused).x +
                          params.counts.at[thread * n_tiles() + tile];
    for (uint i = thread; i < n_rows * WORDS; i += RELIDAR_TILE_THREADS) counters[i] = 0u;
    barrier();
    for (uint turn = 0u; turn < sharing; ++turn) {
        rank_run(run, n, row, gl_SubgroupID % sharing == turn);
        barrier();
    }
    sum_counters(n_rows);
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        if (i >= n) continue;
        uint digit = digit_of(i);
        uint to = digit_start[digit] + half_word(counters[row + digit / 2u], digit) + rank[r];
        for (uint word = 0u; word < KEY_WORDS; ++word)
            params.sorted_keys.at[to * KEY_WORDS + word] = params.keys.at[i * KEY_WORDS + word];
        params.sorted_order.at[to] = !is_null(params.order) ? params.order.at[i] : i;
    }
}
