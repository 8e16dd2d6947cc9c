// SPDX-License-Identifier: Apache-2.0
// Third of five kernels that convert binary trees to trees of wide nodes (up to eight
// children). Computes prefix sums over the tiles of binary nodes, and the total number of
// wide nodes. One workgroup of 256 threads. In place: tiles. Output: wide.count.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
RELIDAR_PARAMS(BvhWideParams);

void main() {
    uvec2 before = uvec2(0u);
    for (uint first = 0u; first < params.n_tiles; first += RELIDAR_BVH_WORKGROUP) {
        uint tile = first + ordered_thread();
        uvec2 total, sum = exclusive_sum(tile < params.n_tiles ? params.tiles.at[tile] : uvec2(0u), total);
        if (tile < params.n_tiles) params.tiles.at[tile] = before + sum;
        before += total;
    }
    // x counts all inner children. The roots, one per model, are nodes too.
    if (ordered_thread() == 0u) params.wide.count.at[0] = params.n_models + before.x;
}
