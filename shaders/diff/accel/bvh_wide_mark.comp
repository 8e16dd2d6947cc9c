// SPDX-License-Identifier: Apache-2.0
// First of five kernels that convert binary trees to trees of wide nodes (up to eight
// children). Starts at the roots, chooses the children of each wide node, and appends
// children that become wide nodes to a queue. One launch processes one level; the last
// launch is a single workgroup that processes all remaining levels. The set of queued
// nodes is the same in every run, not their order. One thread per wide node in the queue.
// Input: tree. Output: queue, slots, level_sizes, demands.
//
// A wide child that fits into its parent is always replaced by its children. Therefore
// child and parent together have at least 10 slots, and a wide node without wide children
// has at least 5 surfels. Thus n surfels need at most n / 4 wide nodes in addition to the
// root.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_binary.glsl"
RELIDAR_CONSTANT(uint, UNTIL_DONE, 0u);
RELIDAR_PARAMS(BvhWideParams);
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer SharedUints { uint at[]; };

/// Tries to replace one child of a node by the grandchildren below this child. All
/// children must fit into the node.
/// @return false if no child was replaced
bool open_child(inout uint slots[RELIDAR_BVH_WIDTH], inout uint n_slots) {
    for (uint s = 0u; s < n_slots; ++s) {
        if (!is_inner_slot(params.tree, slots[s])) continue;
        uint below[RELIDAR_BVH_WIDTH];
        uint n_below = collect_children(params.tree, slots[s], below);
        if (n_slots - 1u + n_below > RELIDAR_BVH_WIDTH) continue;
        slots[s] = below[0];
        for (uint k = 1u; k < n_below; ++k) slots[n_slots++] = below[k];
        return true;
    }
    return false;
}

uint level_end;  // Queue index at which the next level starts.

/// Writes the children of a wide node. Appends the children that become wide nodes to the
/// queue.
void choose_children(uint queue_index) {
    uint node = SharedUints(uvec2(params.queue)).at[queue_index];
    if (node == RELIDAR_BVH_NO_NODE) return;  // the model has no surfels
    uint slots[RELIDAR_BVH_WIDTH];
    uint n_slots = collect_children(params.tree, node, slots);
    while (n_slots < RELIDAR_BVH_WIDTH && open_child(slots, n_slots)) {}
    uint n_inner = 0u, n_surfels = 0u;
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        params.slots.at[8u * queue_index + s] = s < n_slots ? slots[s] : RELIDAR_BVH_NO_NODE;
        if (s >= n_slots) continue;
        uint n = count_surfels(params.tree, slots[s]);
        if (n > RELIDAR_BVH_LEAF_SIZE) ++n_inner;
        else n_surfels += n;
    }
    // Number of inner children in bits 0-7, number of surfels in leaves above. Later
    // kernels sum these numbers to place nodes and leaves.
    params.demands.at[node & ~RELIDAR_BVH_LEAF] = n_inner | n_surfels << 8;
    if (n_inner == 0u) return;
    uint at = level_end + atomicAdd(SharedUints(uvec2(params.level_sizes)).at[params.level + 1u], n_inner);
    for (uint s = 0u; s < n_slots; ++s)
        if (is_inner_slot(params.tree, slots[s]) && at < params.bound)
            SharedUints(uvec2(params.queue)).at[at++] = slots[s];
}

/// Processes the level that starts at queue entry `level_begin`, and then all lower
/// levels of the tree.
void choose_remaining(uint level_begin) {
    for (uint end = level_end; level_begin < end;) {
        for (uint entry = level_begin + gl_LocalInvocationIndex; entry < end; entry += gl_WorkGroupSize.x)
            choose_children(entry);
        memoryBarrierBuffer();
        barrier();
        level_begin = end;
        end = level_end + SharedUints(uvec2(params.level_sizes)).at[params.level + 1u];
        barrier();
    }
}

void main() {
    // Queue entries from `begin` to `level_end` belong to this level. Level 0 contains
    // the roots, one per model.
    uint begin = 0u;
    level_end = params.n_models;
    for (uint k = 1u; k <= params.level; ++k) {
        begin = level_end;
        level_end += params.level_sizes.at[k];
    }
    if (UNTIL_DONE != 0u) choose_remaining(begin);
    else if (begin + thread_index() < level_end) choose_children(begin + thread_index());
}
