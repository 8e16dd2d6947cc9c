// SPDX-License-Identifier: Apache-2.0
// Builds the top-level tree over the instances that can be hit. Sorts their world boxes
// along a space-filling curve, then groups eight elements at a time into a node, level by
// level. A tree without instances is one empty node. One workgroup of 256 threads,
// because a scene has at most hundreds of instances.
// Input: instances, root_of, node_boxes. Output: roots, top_nodes, top_order.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/bvh_build.h"
#include "../../base/workgroup_scan.glsl"
#include "bvh_forest.glsl"
#include "bvh_node.glsl"
#include "bvh_morton.glsl"
RELIDAR_PARAMS(BvhTopParams);

const uint ABSENT = 0xffffffffu;
shared vec3 group_low[64], group_high[64];
shared uint group_present;

/// Makes buffer writes of the workgroup visible to all its threads.
void synchronise() {
    memoryBarrierBuffer();
    barrier();
}

/// Returns the bounding box of an instance in the world frame. For a moving instance, the
/// box contains all poses during the scan. The box includes rounding errors. A rotation
/// moves a point by less than the angle times the distance from the model's origin.
Box make_world_box(InstanceEntry instance, Box model) {
    vec3 x = cross(instance.row1.xyz, instance.row2.xyz), y = cross(instance.row2.xyz, instance.row0.xyz),
         z = cross(instance.row0.xyz, instance.row1.xyz);
    float determinant = dot(instance.row0.xyz, x);
    mat3 world_from_model = mat3(x, y, z) * (1.0 / determinant);
    mat3 size = mat3(abs(world_from_model[0]), abs(world_from_model[1]), abs(world_from_model[2]));
    vec3 shift = vec3(instance.row0.w, instance.row1.w, instance.row2.w);
    vec3 middle = 0.5 * model.low + 0.5 * model.high, half_size = 0.5 * model.high - 0.5 * model.low;
    vec3 centre = world_from_model * (middle - shift);
    // 2e-6 covers the rounding errors of the transform, relative to the size of its
    // terms.
    vec3 grown = size * half_size + 2e-6 * (size * (abs(middle) + half_size + abs(shift)));
    if (instance.moves != 0u)
        grown += 1.00001 * instance.half_span_s *
                 (abs(world_from_model * instance.velocity) +
                  length(instance.turn_rate) * length(abs(middle) + half_size));
    return Box(centre - grown, centre + grown);
}

/// Computes the bounding boxes of all instances in the world frame. Marks instances that
/// cannot be hit as ABSENT.
/// @return bounds of the centres of the boxes that this thread has computed
Box instance_boxes() {
    Box centres = make_empty_box();
    for (uint i = ordered_thread(); i < params.n_padded; i += RELIDAR_BVH_WORKGROUP) {
        bool present = false;
        if (i < params.n_instances) {
            uint root = params.root_of.at[i];
            InstanceEntry m = params.instances.at[i];
            bool placed = m.n_surfels > 0u;
            params.bvh.roots.at[i] = placed ? root : RELIDAR_BVH_NO_NODE;
            Box b = placed ? load_box(params.node_boxes, root) : make_empty_box();
            if (!is_empty(b)) b = make_world_box(m, b);
            present = !is_empty(b);
            store_box(params.boxes, i, b);
            if (present)
                centres = join_boxes(centres, Box(0.5 * b.low + 0.5 * b.high, 0.5 * b.low + 0.5 * b.high));
        }
        SharedUvec2s(uvec2(params.keys)).at[i] = uvec2(present ? 0u : ABSENT, i);
        if (present) atomicAdd(group_present, 1u);
    }
    return centres;
}

/// Returns the union of the boxes of all threads of the workgroup.
Box join_workgroup(Box box) {
    box.low = subgroupMin(box.low);
    box.high = subgroupMax(box.high);
    if (subgroupElect()) {
        group_low[gl_SubgroupID] = box.low;
        group_high[gl_SubgroupID] = box.high;
    }
    barrier();
    for (uint s = 0u; s < gl_NumSubgroups; ++s) box = join_boxes(box, Box(group_low[s], group_high[s]));
    return box;
}

/// Writes the Morton code of each present instance to `keys`.
/// @param centre_bounds bounds of the centres of all instance boxes
void write_keys(Box centre_bounds) {
    SharedUvec2s keys = SharedUvec2s(uvec2(params.keys));
    for (uint i = ordered_thread(); i < params.n_instances; i += RELIDAR_BVH_WORKGROUP) {
        if (keys.at[i].x == ABSENT) continue;
        Box b = load_shared_box(params.boxes, i);
        uvec3 cell = morton_cell(0.5 * b.low + 0.5 * b.high, centre_bounds.low, centre_bounds.high, 10u);
        keys.at[i].x = interleave_bits(cell);
    }
}

bool is_key_after(uvec2 first, uvec2 second) {
    return first.x != second.x ? first.x > second.x : first.y > second.y;
}

/// Sorts the keys (Morton code, instance) with a bitonic sort.
void sort_instances() {
    SharedUvec2s keys = SharedUvec2s(uvec2(params.keys));
    for (uint size = 2u; size <= params.n_padded; size *= 2u)
        for (uint reach = size / 2u; reach > 0u; reach /= 2u) {
            for (uint pair = ordered_thread(); pair < params.n_padded / 2u; pair += RELIDAR_BVH_WORKGROUP) {
                uint i = (pair & ~(reach - 1u)) * 2u + (pair & (reach - 1u)), j = i + reach;
                uvec2 a = keys.at[i], b = keys.at[j];
                // Blocks of `size` keys are sorted alternately in ascending and
                // descending order.
                if (is_key_after(a, b) != ((i & size) == 0u)) continue;
                keys.at[i] = b;
                keys.at[j] = a;
            }
            synchronise();
        }
}

/// Writes a node of the top-level tree. Its children are elements of the level below:
/// instances if `is_lowest_level` is true, otherwise nodes.
/// @param first_child index of the first child in the level below, which has `n_below`
/// elements
/// @param first_node_below if children are nodes: index of their level's first node in
/// top_nodes
void write_node(uint node, uint first_child, uint n_below, uint first_node_below, bool is_lowest_level) {
    Box children[RELIDAR_BVH_WIDTH];
    uint leaves[2] = uint[](0u, 0u), inner_mask = 0u;
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        children[s] = make_empty_box();
        if (first_child + s >= n_below) continue;
        if (is_lowest_level) {
            uint instance = SharedUvec2s(uvec2(params.keys)).at[first_child + s].y;
            params.bvh.top_order.at[first_child + s] = instance;
            children[s] = load_shared_box(params.boxes, instance);
            // A leaf byte has the number of entries (1) in bits 5-7 and the first entry
            // in bits 0-4.
            leaves[s / 4u] |= (s | 1u << 5) << (8u * (s % 4u));
        } else {
            inner_mask |= 1u << s;
            children[s] =
                load_shared_box(params.boxes, params.n_instances + first_node_below + first_child + s);
        }
    }
    params.bvh.top_nodes.at[node].first_child = first_node_below + first_child;
    params.bvh.top_nodes.at[node].first_leaf = first_child;
    params.bvh.top_nodes.at[node].leaves = leaves;
    store_box(params.boxes, params.n_instances + node,
              write_child_boxes(params.bvh.top_nodes, node, inner_mask, children));
}

void main() {
    if (workgroup_index() > 0u) return;
    if (ordered_thread() == 0u) group_present = 0u;
    barrier();
    Box bounds = join_workgroup(instance_boxes());
    synchronise();
    write_keys(bounds);
    synchronise();
    sort_instances();
    // Total number of nodes on all levels. The root is stored first and the lowest level
    // last.
    uint n_nodes = 0u;
    for (uint n = group_present;; n = (n + 7u) / 8u) {
        n_nodes += max((n + 7u) / 8u, 1u);
        if (n <= 8u) break;
    }
    uint first_node_below = 0u;
    bool is_lowest_level = true;
    // Writes the levels from the lowest to the root, because a node needs the boxes below
    // it.
    for (uint n = group_present;;) {
        uint n_level = max((n + 7u) / 8u, 1u);
        n_nodes -= n_level;
        for (uint k = ordered_thread(); k < n_level; k += RELIDAR_BVH_WORKGROUP)
            write_node(n_nodes + k, 8u * k, n, first_node_below, is_lowest_level);
        synchronise();
        if (n_level == 1u) return;
        first_node_below = n_nodes;
        is_lowest_level = false;
        n = n_level;
    }
}
