// SPDX-License-Identifier: Apache-2.0
// Reads a binary tree that is converted to wide nodes, which have up to eight child slots
// (Ylitie et al. 2017, section 3.1). A subtree in a slot becomes a leaf if it has at most
// LEAF_SIZE surfels. Otherwise it becomes another wide node.
//
// Each binary node has a decision word. Bits 0-3 contain its number of surfels, at most
// 15. The following bits contain 3 bits for each number of available slots from 2 to 8.
// These 3 bits contain the number of slots that the left child receives. The value 0
// means that one slot fewer gives the same or a lower cost.
#ifndef RELIDAR_INCLUDED_DIFF_ACCEL_BVH_BINARY_GLSL
#define RELIDAR_INCLUDED_DIFF_ACCEL_BVH_BINARY_GLSL

bool is_leaf(uint child) { return (child & RELIDAR_BVH_LEAF) != 0u; }
uint unpack_surfels(uint decision_word) { return decision_word & 15u; }
/// Returns how many of the available child slots the left child gets. 0 means that one
/// slot fewer is at least as good.
uint unpack_left_slots(uint decision_word, uint n_available_slots) {
    return (decision_word >> (3u * n_available_slots - 2u)) & 7u;
}

/// Returns the number of surfels below a child of a binary node. Numbers above 15 are
/// returned as 15.
uint count_surfels(BvhBinary tree, uint child) {
    return is_leaf(child) ? 1u : unpack_surfels(tree.decisions.at[child]);
}
bool is_inner_slot(BvhBinary tree, uint child) { return count_surfels(tree, child) > RELIDAR_BVH_LEAF_SIZE; }

/// Finds the children (up to eight) that a binary node gets when it is converted to a
/// wide node. Writes them to `children` from left to right.
/// @return number of children
uint collect_children(BvhBinary tree, uint node, out uint children[RELIDAR_BVH_WIDTH]) {
    children[0] = node;
    if (is_leaf(node)) return 1u;  // the model has one surfel
    uint stack[RELIDAR_BVH_WIDTH], shares[RELIDAR_BVH_WIDTH];
    stack[0] = node;
    shares[0] = RELIDAR_BVH_WIDTH;
    uint n_children = 0u;
    for (uint n = 1u; n > 0u;) {
        uint child = stack[--n], n_slots = shares[n], n_left = 0u;
        if (!is_leaf(child)) {
            uint decision_word = tree.decisions.at[child];
            // Gives up slots as long as one slot fewer is as good.
            while (n_slots > 1u && unpack_left_slots(decision_word, n_slots) == 0u) --n_slots;
            if (n_slots > 1u) n_left = unpack_left_slots(decision_word, n_slots);
        }
        if (n_left == 0u) {
            children[n_children++] = child;
            continue;
        }
        uvec2 pair = tree.children.at[child];
        // The left child is pushed last, so that children are written from left to right.
        stack[n] = pair.y;
        shares[n++] = n_slots - n_left;
        stack[n] = pair.x;
        shares[n++] = n_left;
    }
    return n_children;
}

/// Finds the surfels of a subtree that becomes a leaf. Writes their positions in the
/// sorted list of surfels.
/// @param slot root of the subtree
/// @return number of surfels
uint collect_surfels(BvhBinary tree, uint slot, out uint positions[RELIDAR_BVH_LEAF_SIZE]) {
    uint stack[RELIDAR_BVH_LEAF_SIZE];
    stack[0] = slot;
    uint n_surfels = 0u;
    for (uint n = 1u; n > 0u;) {
        uint child = stack[--n];
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
