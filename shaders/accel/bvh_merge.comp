// SPDX-License-Identifier: Apache-2.0
// Bottom up through the binary trees: boxes, and which nodes become wide ones. Where the slots of two children do not fit into one
// wide node, a child of at least 5 slots is closed, so that a model of n surfels makes at most n / 4 wide nodes besides its root.
// One thread a surfel; the second to reach a node goes on. Input: tree, boxes, surfels. Output: the tree's boxes and states.
// Floor: 28 B a surfel read, 28 B written and read again a node.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhMergeParams);

struct Child {
    Box box;
    uint state;
};

Child load_child(uint child) {
    if (is_leaf(child)) return Child(load_box(params.boxes, params.surfels.at[child & ~RELIDAR_BVH_LEAF]), make_state(1u, 1u));
    return Child(load_shared_box(params.tree.boxes, child), SharedUints(uint64_t(params.tree.states)).at[child]);
}

void close(uint child, inout uint state) {
    state |= CLOSED;
    SharedUints(uint64_t(params.tree.states)).at[child] = state;
}

/// Closes children until their slots fit into one wide node. Closing costs a visit of that child; leaving open costs slots.
void make_room(uvec2 children, inout Child left, inout Child right, float slot_cost) {
    uint n_left = slots_of(left.state), n_right = slots_of(right.state);
    if (n_left + n_right <= RELIDAR_BVH_WIDTH) return;
    bool left_can = 2u * n_left > RELIDAR_BVH_WIDTH, right_can = 2u * n_right > RELIDAR_BVH_WIDTH;
    float left_cost = half_area(left.box) + slot_cost * float(n_right), right_cost = half_area(right.box) + slot_cost * float(n_left);
    bool close_left = left_can && (!right_can || left_cost <= right_cost);
    if (close_left) close(children.x, left.state);
    else close(children.y, right.state);
    if (slots_of(left.state) + slots_of(right.state) <= RELIDAR_BVH_WIDTH) return;
    if (close_left) close(children.y, right.state);
    else close(children.x, left.state);
}

void main() {
    uint position = thread_index();
    if (position >= params.n_surfels) return;
    uint node = params.tree.leaf_parents.at[position];
    while (node != RELIDAR_BVH_NO_NODE && arrives_last(params.tree.arrivals, node, 2u)) {
        uvec2 children = params.tree.children.at[node];
        Child left = load_child(children.x), right = load_child(children.y);
        Box box = joined(left.box, right.box);
        uint n_surfels = min(surfels_of(left.state) + surfels_of(right.state), 15u), n_slots = 1u;
        if (n_surfels > RELIDAR_BVH_LEAF_SIZE) {
            make_room(children, left, right, half_area(box) / float(RELIDAR_BVH_WIDTH));
            n_slots = slots_of(left.state) + slots_of(right.state);
        }
        store_shared_box(params.tree.boxes, node, box);
        SharedUints(uint64_t(params.tree.states)).at[node] = make_state(n_slots, n_surfels);
        node = params.tree.parents.at[node];
    }
}
