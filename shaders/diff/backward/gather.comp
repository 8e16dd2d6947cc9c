// SPDX-License-Identifier: Apache-2.0
// Sums the gradients of hits by surfel without atomics, in the order of the rays, so that
// the result is the same in every run. The hits are sorted by gradient row (one row per
// surfel and instance).
//
// Each thread processes a block of 32 hits. It adds the sums of rows that lie completely
// within its block. Partial sums of rows that extend over several blocks are stored in
// `parts`, and kernel backward/gather_heads adds them later.
//
// Input: scene, upstream, hits, rows, slots, n_hits. Accumulated: d_records, d_sh.
// Output: parts. Maximum: most_hits.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../traversal/includes.glsl"
#include "../../base/atomic_add.glsl"
#include "../shared/backward.h"
#include "hit_gradient.glsl"
RELIDAR_PARAMS(GatherParams);
#include "gather.glsl"

/// Adds the gradient of hit `index` to the local sums of this thread.
/// @return the instance of the hit
uint add_hit_gradients(TraceScene scene, uint index, uint row) {
    HitRecord h = params.hits.at[params.slots.at[index]];
    InstanceEntry m = scene.instances.at[h.instance];
    DeviceRay entry = scene.rays.at[scene.first_ray + h.ray * scene.ray_stride];
    // Clears the cached transform of the previous ray, because this hit may belong to
    // another ray.
    entered_instance = kNoInstance;
    ray_basis_instance = kNoInstance;
    if (LIKELIHOOD != 0u) load_measurement(scene, h.ray);
    HitGradient d = compute_hit_gradient(scene, make_ray(entry), params.upstream.at[h.ray], h.instance,
                                         row - m.first_row + m.first_surfel, h.w, h.d_alpha);
    for (uint k = 0u; k < 16u; ++k) sums[k] += d.lanes[k];
    if (SH_PER_SURFEL == 0u)
        for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k)
            sh_sums[k] += d.d_channel[k / RELIDAR_SH_COEFFICIENTS] * ray_basis[k % RELIDAR_SH_COEFFICIENTS];
    return h.instance;
}

/// Adds this block's sum of a row to the result. If the row also has hits in other
/// blocks, only stores the sum. Kernel backward/gather_heads then adds all stored sums of
/// the row. Two instances may share SH coefficients. Then one addition per instance gives
/// a repeatable result, but more additions do not.
/// @param begins_here true if the row has no hits in earlier blocks
/// @param goes_on true if the row continues in the next block
void store_row_sum(uint block, uint row, uint instance, bool begins_here, bool goes_on) {
    if (begins_here && !goes_on) {
        add_to_row(row, instance);
        return;
    }
    uint part = begins_here ? get_tail_index(block) : get_head_index(block);
    for (uint k = 0u; k < 16u; ++k) params.parts.at[part + k] = sums[k];
    for (uint k = 16u; k < get_partial_sum_width(); ++k) params.parts.at[part + k] = sh_sums[k - 16u];
}

void main() {
    uint block = get_thread_index(), first = block * RELIDAR_GATHER_BLOCK;
    if (block == 0u) params.most_hits.at[0] = max(params.most_hits.at[0], params.n_hits.at[0]);
    uint end = get_block_end(block);
    if (first >= end) return;
    uint row = params.rows.at[first], instance = 0u;
    bool begins_here = first == 0u || params.rows.at[first - 1u] != row;
    clear_sums();
    for (uint i = first; i < end; ++i) {
        uint next = params.rows.at[i];
        if (next >= params.n_rows) break;  // slots without a hit are sorted to the end
        if (next != row) {
            store_row_sum(block, row, instance, begins_here, false);
            clear_sums();
            row = next;
            begins_here = true;
        }
        instance = add_hit_gradients(params.scene, i, row);
    }
    if (row < params.n_rows)
        store_row_sum(block, row, instance, begins_here, end < n_sorted() && params.rows.at[end] == row);
}
