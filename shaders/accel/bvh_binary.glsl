// SPDX-License-Identifier: Apache-2.0
// Binary nodes on their way to wide ones. A node's state holds how many slots its subtree takes in the wide node of an ancestor, how
// many surfels it has (counted to 15), and whether it is closed: made a wide node of its own, one slot to its parent.
#ifndef RELIDAR_INCLUDED_ACCEL_BVH_BINARY_GLSL
#define RELIDAR_INCLUDED_ACCEL_BVH_BINARY_GLSL

const uint CLOSED = 0x100u;
uint make_state(uint n_slots, uint n_surfels) { return n_slots | n_surfels << 4; }
uint slots_of(uint state) { return (state & CLOSED) != 0u ? 1u : state & 15u; }
uint surfels_of(uint state) { return (state >> 4) & 15u; }

bool is_leaf(uint child) { return (child & RELIDAR_BVH_LEAF) != 0u; }

/// Whether a node becomes a wide node: closed, or the root of a model.
bool becomes_wide(BvhBinary tree, uint node) {
    return (tree.states.at[node] & CLOSED) != 0u || (tree.parents.at[node] == RELIDAR_BVH_NO_NODE && tree.children.at[node].x != RELIDAR_BVH_NO_NODE);
}

bool is_inner_slot(BvhBinary tree, uint child) { return !is_leaf(child) && (tree.states.at[child] & CLOSED) != 0u; }

/// The children of the wide node made of a binary node, from left to right.
uint collect_slots(BvhBinary tree, uint node, out uint slots[RELIDAR_BVH_WIDTH]) {
    if (surfels_of(tree.states.at[node]) <= RELIDAR_BVH_LEAF_SIZE) {
        slots[0] = node;
        return 1u;
    }
    uint stack[RELIDAR_BVH_WIDTH];   // each entry still yields a slot: never more than there are
    uvec2 children = tree.children.at[node];
    stack[0] = children.y;
    stack[1] = children.x;
    uint n_slots = 0u;
    for (uint n = 2u; n > 0u;) {
        uint child = stack[--n];
        if (is_leaf(child) || slots_of(tree.states.at[child]) == 1u) {
            slots[n_slots++] = child;
        } else {
            children = tree.children.at[child];
            stack[n++] = children.y;
            stack[n++] = children.x;
        }
    }
    return n_slots;
}

/// Sorted positions of the surfels of a leaf slot.
uint collect_surfels(BvhBinary tree, uint slot, out uint positions[RELIDAR_BVH_LEAF_SIZE]) {
    uint stack[RELIDAR_BVH_LEAF_SIZE + 1u];
    stack[0] = slot;
    uint n_surfels = 0u;
    for (uint n = 1u; n > 0u;) {
        uint child = stack[--n];
        if (child == RELIDAR_BVH_NO_NODE) continue;
        if (is_leaf(child)) {
            positions[n_surfels++] = child & ~RELIDAR_BVH_LEAF;
        } else {
            uvec2 children = tree.children.at[child];
            stack[n++] = children.y;
            stack[n++] = children.x;
        }
    }
    return n_surfels;
}
#endif
