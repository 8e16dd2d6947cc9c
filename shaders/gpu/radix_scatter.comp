// SPDX-License-Identifier: Apache-2.0
// Last of three kernels of a radix sort pass. Moves each key behind all keys with smaller
// digits and behind earlier keys with the same digit. A workgroup of 256 threads
// processes a tile of 4096 keys, each subgroup a contiguous part of it. Ballots compute
// the rank of one key per lane, so that keys with equal digits keep their order. With
// more than 32 subgroups (of 4 lanes), two subgroups share their counters and run one
// after the other.
// Input: n_keys, keys, order, counts, totals. Output: sorted_keys, sorted_order.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
#include "../base/workgroup_scan.glsl"
RELIDAR_PARAMS(RadixSortParams);
#include "radix.glsl"

const uint ROUNDS = RELIDAR_TILE_SIZE / RELIDAR_TILE_THREADS;
// Number of words for the counts of all digit values. A word contains two 16-bit counts,
// because a workgroup sorts fewer than 65536 keys.
const uint WORDS = RELIDAR_SORT_DIGITS / 2u;
const uint ROWS = 32u;  // Number of rows of counters that fit into 16 KiB of shared memory.
// Histogram of the workgroup's keys: number of keys with each value of the current digit.
// There is one row of counters per subgroup. If there are more than ROWS subgroups,
// several subgroups share a row.
shared uint counters[ROWS * WORDS];
// For each value of the current digit: index in the output at which this workgroup writes
// its first key with this value.
shared uint digit_start[RELIDAR_SORT_DIGITS];
uint rank[ROUNDS];  // Ranks of this lane's keys. The lane ranks one key per round.

/// Returns the number of subgroups that share one row of `counters`.
uint row_subgroups() { return (gl_NumSubgroups + ROWS - 1u) / ROWS; }

/// Returns the count of a digit value from a word with two counts.
uint digit_count(uint packed_counts, uint digit) { return (packed_counts >> (16u * (digit & 1u))) & 0xffffu; }

/// Returns a bit mask of the lanes whose keys have the same digit as the key of this
/// lane. Lanes without a key form a separate group.
uvec2 same_digit_lanes(bool valid, uint digit) {
    uvec2 with_key = subgroupBallot(valid).xy;
    uvec2 peers = valid ? with_key : ~with_key;
    for (uint bit = 1u; bit < RELIDAR_SORT_DIGITS; bit <<= 1) {
        bool set = (digit & bit) != 0u;
        uvec2 lanes = subgroupBallot(set).xy;
        peers &= set ? lanes : ~lanes;
    }
    return peers;
}

/// Computes the rank of each key in this subgroup's part of the tile (number of earlier
/// keys with the same digit in the same row of counters), and counts the keys. Every
/// subgroup must call this function, because a subgroup barrier waits for all subgroups
/// on lavapipe.
/// @param ranks_now true if this subgroup ranks its keys in this call
void rank_keys(uint first_key, uint key_count, uint counter_row, bool ranks_now) {
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = first_key + r * gl_SubgroupSize;
        bool valid = ranks_now && i < key_count;
        uint digit = valid ? radix_digit(i) : 0u;
        uvec2 peers = same_digit_lanes(valid, digit), before = peers & gl_SubgroupLtMask.xy;
        uint smaller = bitCount(before.x) + bitCount(before.y);
        if (ranks_now) rank[r] = digit_count(counters[counter_row + digit / 2u], digit) + smaller;
        // All lanes must read the old counts before the first lane of each group adds to
        // them.
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        if (valid && smaller == 0u)
            atomicAdd(counters[counter_row + digit / 2u], (bitCount(peers.x) + bitCount(peers.y))
                                                              << (16u * (digit & 1u)));
        subgroupMemoryBarrierShared();
        subgroupBarrier();
    }
}

/// Replaces the counts in each row of `counters` by the sums of all earlier rows.
void sum_counters(uint n_rows) {
    if (ordered_thread() >= WORDS) return;
    uint sum = 0u;
    for (uint at = ordered_thread(); at < n_rows * WORDS; at += WORDS) {
        uint word = counters[at];
        counters[at] = sum;
        sum += word;
    }
}

void main() {
    uint tile = workgroup_index(), thread = ordered_thread(), n = n_keys();
    if (tile >= n_tiles()) return;
    uint sharing = row_subgroups(), n_rows = gl_NumSubgroups / sharing, row = gl_SubgroupID / sharing * WORDS;
    // Index of this lane's first key. A subgroup processes consecutive keys, one per lane
    // in each round.
    uint run = tile * RELIDAR_TILE_SIZE + gl_SubgroupID * gl_SubgroupSize * ROUNDS + gl_SubgroupInvocationID;
    uvec2 unused;
    digit_start[thread] = exclusive_sum(uvec2(params.totals.at[thread], 0u), unused).x +
                          params.counts.at[thread * n_tiles() + tile];
    for (uint i = thread; i < n_rows * WORDS; i += RELIDAR_TILE_THREADS) counters[i] = 0u;
    barrier();
    // Subgroups that share a row of counters take turns in the order of their keys,
    // because a rank counts the earlier keys of the row.
    for (uint turn = 0u; turn < sharing; ++turn) {
        rank_keys(run, n, row, gl_SubgroupID % sharing == turn);
        barrier();
    }
    sum_counters(n_rows);
    barrier();
    for (uint r = 0u; r < ROUNDS; ++r) {
        uint i = run + r * gl_SubgroupSize;
        if (i >= n) continue;
        uint digit = radix_digit(i);
        uint to = digit_start[digit] + digit_count(counters[row + digit / 2u], digit) + rank[r];
        for (uint word = 0u; word < KEY_WORDS; ++word)
            params.sorted_keys.at[to * KEY_WORDS + word] = params.keys.at[i * KEY_WORDS + word];
        params.sorted_order.at[to] = !is_null(params.order) ? params.order.at[i] : i;
    }
}
