// SPDX-License-Identifier: Apache-2.0
// Sums the gradients of hits by surfel without atomics, in the order of the rays, so that
// the result is the same in every run. The hits are sorted by gradient row. Each thread
// processes a block of 32 hits. Kernel backward/gather_heads adds the sums of rows that
// extend over several blocks (`parts`).
// Input: scene, upstream, hits, rows, slots, n_hits. Accumulated: d_records, d_sh.
// Output: parts. Maximum: most_hits.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../traversal/includes.glsl"
#include "relidar/base/atomic_add.glsl"
#include "../shared/backward.h"
#include "hit_gradient.glsl"
RELIDAR_PARAMS(GatherParams);
#include "gather.glsl"

/// Adds the gradient of a hit to the local sums of this thread.
/// @param sorted_hit index of the hit in the list of hits sorted by gradient row
/// @return the instance of the hit
uint add_hit(TraceScene scene, uint sorted_hit, uint gradient_row) {
    HitRecord h = params.hits.at[params.slots.at[sorted_hit]];
    InstanceEntry m = scene.instances.at[h.instance];
    DeviceRay entry = scene.rays.at[scene.first_ray + h.ray * scene.ray_stride];
    // Clears the cached transform of the previous ray, because this hit may belong to
    // another ray.
    entered_instance = kNoInstance;
    ray_basis_instance = kNoInstance;
    if (LIKELIHOOD != 0u) cache_range(scene, h.ray);
    HitGradient d = hit_vjp(scene, make_ray(entry), params.upstream.at[h.ray], h.instance,
                            gradient_row - m.first_row + m.first_surfel, h.w, h.d_alpha);
    for (uint k = 0u; k < 16u; ++k) sums[k] += d.lanes[k];
    if (SH_PER_SURFEL == 0u)
        for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k)
            sh_sums[k] += d.d_channel[k / RELIDAR_SH_COEFFICIENTS] * ray_basis[k % RELIDAR_SH_COEFFICIENTS];
    return h.instance;
}

/// Adds this block's sum of a row to the result. If the row also has hits in other
/// blocks, only stores the sum for backward/gather_heads. Two instances may share SH
/// coefficients; one addition per instance gives a repeatable result, more additions do
/// not.
void store_row_sum(uint block, uint gradient_row, uint instance, bool starts_in_block,
                   bool continues_in_next_block) {
    if (starts_in_block && !continues_in_next_block) {
        add_surfel_sums(gradient_row, instance);
        return;
    }
    // A block can have two rows that continue in other blocks: its first and its last
    // one.
    uint part = starts_in_block ? last_row_sum(block) : first_row_sum(block);
    for (uint k = 0u; k < 16u; ++k) params.parts.at[part + k] = sums[k];
    for (uint k = 16u; k < floats_per_sum(); ++k) params.parts.at[part + k] = sh_sums[k - 16u];
}

void main() {
    uint block = thread_index(), first = block * RELIDAR_GATHER_BLOCK;
    if (block == 0u) params.most_hits.at[0] = max(params.most_hits.at[0], params.n_hits.at[0]);
    uint end = block_end(block);
    if (first >= end) return;
    // `row` is the current row. Its sum is stored when the next row begins.
    uint row = params.rows.at[first], instance = 0u;
    bool starts_in_block = first == 0u || params.rows.at[first - 1u] != row;
    clear_sums();
    for (uint i = first; i < end; ++i) {
        uint next = params.rows.at[i];
        if (next >= params.n_rows) break;  // slots without a hit are sorted to the end
        if (next != row) {
            store_row_sum(block, row, instance, starts_in_block, false);
            clear_sums();
            row = next;
            starts_in_block = true;
        }
        instance = add_hit(params.scene, i, row);
    }
    if (row < params.n_rows)
        store_row_sum(block, row, instance, starts_in_block,
                      end < n_sorted_hits() && params.rows.at[end] == row);
}
