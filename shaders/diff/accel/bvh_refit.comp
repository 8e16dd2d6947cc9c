// SPDX-License-Identifier: Apache-2.0
// Computes the boxes of all tree nodes from the boxes of the surfels, bottom up, for all
// or some of the models.
//
// Eight lanes of a subgroup process one node, one child per lane (in subgroups of four
// lanes, two children). Nodes without inner children are processed first. The group that
// finishes the last child of a parent continues with the parent. Input: boxes, topology
// of wide. Output: origin, exponents and child boxes of the nodes, wide.boxes.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_node.glsl"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(BvhRefitParams);

const uint OF_NODE = LANES < RELIDAR_BVH_WIDTH ? LANES : RELIDAR_BVH_WIDTH;  // lanes per node
const uint OF_LANE = RELIDAR_BVH_WIDTH / OF_NODE;                            // children per lane: 1 or 2
uint lane_in_group() { return gl_SubgroupInvocationID % OF_NODE; }
/// Returns the child slot that this lane processes.
/// @param child_of_lane number of the child among the children of this lane: 0 or 1
uint child_slot(uint child_of_lane) { return child_of_lane * OF_NODE + lane_in_group(); }

/// Returns the union of the boxes of all lanes that process the same node. All lanes of
/// the subgroup must call this function, because it uses shuffles.
Box join_lane_boxes(Box lane_box) {
    for (uint step = 1u; step < OF_NODE; step *= 2u)
        lane_box = join_boxes(
            lane_box, Box(subgroupShuffleXor(lane_box.low, step), subgroupShuffleXor(lane_box.high, step)));
    return lane_box;
}
/// Combines the bytes of four neighbouring lanes to a word, for three words. Each lane
/// has shifted its bytes to their positions in the words.
uvec3 pack_lane_bytes(uvec3 lane_bytes) {
    for (uint step = 1u; step < 4u; step *= 2u) lane_bytes |= subgroupShuffleXor(lane_bytes, step);
    return lane_bytes;
}
bool broadcast_first(bool value) { return subgroupShuffle(value, gl_SubgroupInvocationID - lane_in_group()); }

/// Returns the box of a child of a node. The box of an inner child is already finished.
/// The box of a leaf is the union of the boxes of its surfels.
Box make_child_box(uint node, uint slot, uint first_surfel, uint inner_mask) {
    if ((inner_mask >> slot & 1u) != 0u)
        // Inner children are consecutive nodes. The index of this child is the number
        // of inner slots before its slot.
        return load_shared_box(params.wide.boxes, params.wide.nodes.at[node].first_child +
                                                      bitCount(inner_mask & ((1u << slot) - 1u)));
    // Byte of this slot: number of surfels (3 bits) and offset of the first (5 bits).
    uint leaf = params.wide.nodes.at[node].leaves[slot / 4u] >> (8u * (slot % 4u)) & 255u;
    Box b = make_empty_box();
    uint first = params.wide.nodes.at[node].first_leaf + (leaf & 31u);
    for (uint k = 0u; k < leaf >> 5; ++k)
        b = join_boxes(b, load_box(params.boxes, first_surfel + params.wide.order.at[first + k]));
    return b;
}

/// Computes the boxes of one node with a group of eight lanes. Groups without a node must
/// call this function too, because it uses subgroup shuffles.
void refit_node(bool has_node, uint node, uint first_surfel, uint inner_mask) {
    Box children[2], bounds = make_empty_box();
    for (uint k = 0u; k < OF_LANE; ++k) {
        children[k] = make_empty_box();
        if (has_node) children[k] = make_child_box(node, child_slot(k), first_surfel, inner_mask);
        bounds = join_boxes(bounds, children[k]);
    }
    bounds = join_lane_boxes(bounds);
    NodeGrid grid = make_node_grid(bounds);
    for (uint k = 0u; k < OF_LANE; ++k) {
        uint slot = child_slot(k);
        uvec3 steps = quantise_box(grid, children[k]);
        uvec3 low = pack_lane_bytes((steps & 255u) << (8u * (slot % 4u))),
              high = pack_lane_bytes((steps >> 8) << (8u * (slot % 4u)));
        if (has_node && slot % 4u == 0u) write_four_bounds(params.wide.nodes, node, slot / 4u, low, high);
    }
    if (!has_node || lane_in_group() != 0u) return;
    store_grid(params.wide.nodes, node, grid, inner_mask);
    store_box(params.wide.boxes, node, bounds);
}

/// Counts the finished children of a parent node with an atomic counter. Memory barriers
/// make the boxes of all children visible to the caller.
/// @param has_finished_child true if this group of lanes has finished a child
/// @param n_children number of children of the parent
/// @return true for the group that finished the last child
bool is_last_child(bool has_finished_child, uint parent, uint n_children) {
    bool last = false;
    memoryBarrierBuffer();
    if (has_finished_child && lane_in_group() == 0u)
        last = atomicAdd(SharedUints(uvec2(params.wide.arrivals)).at[parent], 1u) + 1u == n_children;
    memoryBarrierBuffer();
    return broadcast_first(last);
}

/// Computes the boxes of a node whose children are all leaves, and then of its ancestors.
/// Stops at an ancestor if another child of this ancestor has no new box yet.
void refit_ancestors(bool has_node, uint node) {
    uint inner_mask = has_node ? params.wide.nodes.at[node].exponents >> 24 : 1u;
    uvec2 link = has_node ? params.wide.links.at[node] : uvec2(RELIDAR_BVH_NO_NODE);
    // True if all children are leaves and the model is selected. link.y is the first
    // surfel of the node's model. The host selects a range of first surfels.
    has_node = inner_mask == 0u && link.y >= params.first_surfel && link.y <= params.last_surfel;
    while (subgroupAny(has_node)) {
        refit_node(has_node, node, link.y, inner_mask);
        has_node = has_node && link.x != RELIDAR_BVH_NO_NODE;
        if (has_node) {
            node = link.x;
            inner_mask = params.wide.nodes.at[node].exponents >> 24;
        }
        has_node = is_last_child(has_node, node, bitCount(inner_mask));
        if (has_node) {
            if (lane_in_group() == 0u) params.wide.arrivals.at[node] = 0u;  // reset for the next launch
            link = params.wide.links.at[node];
        }
    }
}

void main() {
    uint n_nodes = min(params.bound, params.wide.count.at[0]), together = LANES / OF_NODE;
    uint subgroup = workgroup_index() * gl_NumSubgroups + gl_SubgroupID, n_subgroups = thread_count() / LANES;
    for (uint first = subgroup * together; first < n_nodes; first += n_subgroups * together) {
        uint node = first + gl_SubgroupInvocationID / OF_NODE;
        refit_ancestors(node < n_nodes, node);
    }
}
