// SPDX-License-Identifier: Apache-2.0
// Boxes of the wide nodes, bottom up, from the boxes of the surfels: after a build and whenever surfels have moved; on demand those of some
// models alone. Of n threads each looks at every n-th wide node. Those without inner children start, and the last child to reach a node
// goes on. Input: boxes, topology of wide. Output: origin, exponents and child boxes of the nodes, wide.boxes. Floor: 28 B a surfel read,
// 28 B read and 104 B written a wide node.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_node.glsl"
RELIDAR_PARAMS(BvhRefitParams);

Box leaf_box(uint first_entry, uint count, uint first_surfel) {
    Box b = empty_box();
    for (uint k = 0u; k < count; ++k) b = joined(b, load_box(params.boxes, first_surfel + params.wide.order.at[first_entry + k]));
    return b;
}

void refit_node(uint node, uint first_surfel, uint inner_mask) {
    uint child = params.wide.nodes.at[node].first_child, first_leaf = params.wide.nodes.at[node].first_leaf;
    uint leaves[2] = params.wide.nodes.at[node].leaves;
    Box boxes[RELIDAR_BVH_WIDTH];
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        uint leaf = (leaves[s / 4u] >> (8u * (s % 4u))) & 255u;
        boxes[s] = empty_box();
        if ((inner_mask >> s & 1u) != 0u) boxes[s] = load_shared_box(params.wide.boxes, child++);
        else if (leaf != 0u) boxes[s] = leaf_box(first_leaf + (leaf & 31u), leaf >> 5, first_surfel);
    }
    store_shared_box(params.wide.boxes, node, write_boxes(params.wide.nodes, node, inner_mask, boxes));
}

/// Refits a node without inner children, and every node above whose children are then all refitted.
void refit_upwards(uint node) {
    uint inner_mask = params.wide.nodes.at[node].exponents >> 24;
    if (inner_mask != 0u) return;
    uvec2 link = params.wide.links.at[node];
    if (link.y < params.first_surfel || link.y > params.last_surfel) return;   // a model that stays as it is
    for (;;) {
        refit_node(node, link.y, inner_mask);
        node = link.x;
        if (node == RELIDAR_BVH_NO_NODE) return;
        inner_mask = params.wide.nodes.at[node].exponents >> 24;
        if (!arrives_last(params.wide.arrivals, node, bitCount(inner_mask))) return;
        params.wide.arrivals.at[node] = 0u;   // for the next launch
        link = params.wide.links.at[node];
    }
}

void main() {
    uint n_nodes = min(params.bound, params.wide.count.at[0]);
    for (uint node = thread_index(); node < n_nodes; node += thread_count()) refit_upwards(node);
}
