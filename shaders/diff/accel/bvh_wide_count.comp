// SPDX-License-Identifier: Apache-2.0
// Second of five kernels that convert binary trees to trees of wide nodes. Computes
// prefix sums of the space that each wide node needs, within tiles of 4096 binary nodes.
// Workgroups of 256 threads. Input: demands. Output: offsets within the tile, sums of the
// tiles.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhWideParams);

/// Returns the number of children that are wide nodes and the number of surfels in
/// leaves.
uvec2 unpack_counts(uint packed_counts) { return uvec2(packed_counts & 255u, packed_counts >> 8); }

void main() {
    uint tile = workgroup_index();
    if (tile >= params.n_tiles) return;
    // Number of consecutive nodes per thread.
    const uint RUN = RELIDAR_BVH_TILE / RELIDAR_BVH_WORKGROUP;
    uint first = tile * RELIDAR_BVH_TILE + ordered_thread() * RUN, end = min(first + RUN, params.n_surfels);
    uvec2 sums = uvec2(0u), total;
    for (uint node = first; node < end; ++node) sums += unpack_counts(params.demands.at[node]);
    uvec2 before = exclusive_sum(sums, total);
    for (uint node = first; node < end; ++node) {
        params.offsets.at[node] = before;
        before += unpack_counts(params.demands.at[node]);
    }
    if (ordered_thread() == 0u) params.tiles.at[tile] = total;
}
