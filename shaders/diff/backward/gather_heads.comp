// SPDX-License-Identifier: Apache-2.0
// Adds the partial sums of gradient rows that extend over several blocks of hits. The
// thread of the block in which a row begins adds all partial sums of this row, in the
// order of the blocks. One thread per block. Input: scene, hits, rows, slots, n_hits,
// parts. Accumulated: d_records, d_sh.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../traversal/includes.glsl"
#include "relidar/base/atomic_add.glsl"
#include "../shared/backward.h"
RELIDAR_PARAMS(GatherParams);
#include "gather.glsl"

/// Returns true if the last row of this block begins in the block. Otherwise, an earlier
/// block adds the sums of this row.
bool has_row_start(uint block, uint gradient_row) {
    uint first = block * RELIDAR_GATHER_BLOCK;
    return params.rows.at[first] != gradient_row || first == 0u || params.rows.at[first - 1u] != gradient_row;
}

void add_partial_sum(uint parts_index) {
    for (uint k = 0u; k < 16u; ++k) sums[k] += params.parts.at[parts_index + k];
    for (uint k = 16u; k < floats_per_sum(); ++k) sh_sums[k - 16u] += params.parts.at[parts_index + k];
}

void main() {
    uint block = thread_index(), n = n_sorted_hits();
    uint end = block_end(block);
    // the last row of this block does not continue
    if (end >= n || block * RELIDAR_GATHER_BLOCK >= end) return;
    uint row = params.rows.at[end - 1u];
    if (row >= params.n_rows || params.rows.at[end] != row || !has_row_start(block, row)) return;
    clear_sums();
    add_partial_sum(last_row_sum(block));
    // Adds the parts of all later blocks that begin with the same row.
    for (uint later = block + 1u; end < n && params.rows.at[end] == row; ++later) {
        add_partial_sum(first_row_sum(later));
        end = block_end(later);
    }
    // A row belongs to one instance, so the last hit of this block gives the instance.
    add_surfel_sums(row, params.hits.at[params.slots.at[block_end(block) - 1u]].instance);
}
