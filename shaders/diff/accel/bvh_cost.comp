// SPDX-License-Identifier: Apache-2.0
// Computes the cost of all trees with the surface area heuristic. If the cost has grown,
// the host rebuilds the trees. The cost of a node is half its surface area. The cost of a
// leaf is half its surface area times the cost of testing its surfels. One thread per
// wide node, one sum per workgroup. Input: wide. Output: partial sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
#include "bvh_forest.glsl"
RELIDAR_PARAMS(BvhCostParams);
shared float subgroup_costs[64];

/// Returns the cost of all leaf slots of a node: half the area of the box of the leaf
/// times its number of surfels times SURFEL_COST.
float leaf_cost(uint node, uint first_surfel) {
    uint first_leaf = params.wide.nodes.at[node].first_leaf;
    uint leaves[2] = params.wide.nodes.at[node].leaves;
    float cost = 0.0;
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        // One byte per slot: number of surfels (3 bits), offset of the first (5 bits).
        // The number is 0 if the slot has no leaf.
        uint leaf = (leaves[s / 4u] >> (8u * (s % 4u))) & 255u, count = leaf >> 5;
        Box b = make_empty_box();
        for (uint k = 0u; k < count; ++k)
            b = join_boxes(b, load_box(params.boxes,
                                       first_surfel + params.wide.order.at[first_leaf + (leaf & 31u) + k]));
        cost += half_area(b) * SURFEL_COST * float(count);
    }
    return cost;
}

void main() {
    uint group = workgroup_index(), node = group * RELIDAR_BVH_WORKGROUP + ordered_thread();
    float cost = 0.0;
    if (node < min(params.bound, params.wide.count.at[0]))
        cost = half_area(load_box(params.wide.boxes, node)) + leaf_cost(node, params.wide.links.at[node].y);
    cost = subgroupAdd(cost);
    if (subgroupElect()) subgroup_costs[gl_SubgroupID] = cost;
    barrier();
    if (ordered_thread() != 0u) return;
    // Thread 0 already has the sum of subgroup 0.
    for (uint s = 1u; s < gl_NumSubgroups; ++s) cost += subgroup_costs[s];
    if (group * RELIDAR_BVH_WORKGROUP < params.bound) params.sums.at[group] = cost;
}
