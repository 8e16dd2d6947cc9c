// SPDX-License-Identifier: Apache-2.0
// Finds hits with a two-level tree of nodes with up to eight children, whose boxes are
// quantised (relidar/diff/bvh.h). The traversal uses a stack and visits near children
// first. At an instance of the top-level tree, it transforms the ray into the frame of
// the model.
//
// A specialisation constant selects whether each ray is traversed separately, or all rays
// of a subgroup together. In joint traversal, the subgroup visits a node if any of its
// rays needs the node, and tests its surfels in all lanes. All rays process the top entry
// of the first active ray; a ray with a different stack waits. Therefore no hit is lost,
// however the lanes diverge and reconverge, and all lanes load from the same address.
//
// On a CPU, lanes load cooperatively (kSharesLoads, shared_load.glsl). Its compiler runs
// each loop once more, without an active lane, to detect its end. Therefore loops with
// few iterations test their condition at the end.
//
// No hit is lost, for these reasons:
// - The box test uses the same ray as intersect(): entered_origin, entered_direction. t
//   is the same in the world and in a model, whatever the instance's scale.
// - The distance to a box side, q scale + at, has an error of at most 8 roundings of its
//   terms. The slack, kRelativeSlack times both terms, is larger.
// - A direction component below kLeastSlope is replaced by kLeastSlope, so a division by
//   zero is impossible. Over 100 km this moves the ray by 10^-7 m, less than the slack.
// - A moving model is inside its box of the top-level tree whenever a ray is fired,
//   because enter_instance() clamps the time of a ray to its span.
// - A node is skipped only if it is behind `end` or before `start`. Both include 1e-4 m +
//   1e-5 t for the rounding error of t, as in every traversal method (README.md).
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SOFTWARE_BVH_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SOFTWARE_BVH_GLSL
#include "shared_load.glsl"
RELIDAR_CONSTANT(uint, TOGETHER, 0u);
const uint kSharesLoads = 2u;
RELIDAR_CONSTANT(uint, COUNT_VISITS, 0u);

// Capacity of the traversal stack. Each tree level adds at most 7 entries, so 64 entries
// are enough for 9 levels of full nodes. If the stack overflows in a deeper tree, the ray
// ends early and is counted as an error.
const uint kStackSize = 64u;
const uint kInstanceEntry = 0x80000000u;  // flag of a stack entry that is an instance
// Flag of a stack entry that is a node of the top-level tree. Without a flag, an entry is
// a node of the current instance's model.
const uint kTopEntry = 0x40000000u;
const float kNoHit_t = 1e30;
// Bound for the relative rounding error of the distance to a box side (8 roundings of
// 2^-24 each).
const float kRelativeSlack = 5e-7;
const float kLeastSlope = 1e-12;

uint stack_entry[SLOTS];  // Traversal stack. SLOTS is one larger than the number of used entries.
// For each element of stack_entry: distance at which this ray enters the box of the node.
// kNoHit_t if the ray misses the box.
float stack_t[SLOTS];
uint stack_size;
bool stack_full;

/// Ray in the frame of the current tree, with precomputed values for box tests.
struct BoxRay {
    vec3 origin;
    vec3 inverse;  // 1 / direction, per axis
    float start;   // Distances along the ray in m. Boxes before `start` or behind `end` are skipped.
    float end;
};

/// Stores the ray of the current tree and the inverse of its direction. Replaces
/// components near zero, so that the inverse is finite.
void prepare_box_ray(inout BoxRay box_ray, vec3 origin, vec3 direction) {
    vec3 least = mix(vec3(kLeastSlope), vec3(-kLeastSlope), lessThan(direction, vec3(0.0)));
    box_ray.origin = origin;
    box_ray.inverse = 1.0 / mix(direction, least, lessThan(abs(direction), vec3(kLeastSlope)));
}

uint unpack_byte(uvec2 bytes, uint slot) {
    return ((slot < 4u ? bytes.x : bytes.y) >> (8u * (slot & 3u))) & 255u;
}

/// Intersects a ray with the eight child boxes of a node.
/// @param t output: distance at which the ray enters each box that it intersects
/// @return bit mask of the boxes that the ray intersects within [start, end]. May include
/// unused child slots
uint intersect_boxes(BvhNode node, BoxRay ray, out float t[RELIDAR_BVH_WIDTH]) {
    vec3 scale =
        uintBitsToFloat((uvec3(node.exponents, node.exponents >> 8u, node.exponents >> 16u) & 255u) << 23u) *
        ray.inverse;
    vec3 at = (node.origin - ray.origin) * ray.inverse;
    vec3 slack = kRelativeSlack * (abs(at) + 255.0 * abs(scale));
    vec3 near_at = at - slack, far_at = at + slack;
    uvec2 low[3] = uvec2[](uvec2(node.low_x[0], node.low_x[1]), uvec2(node.low_y[0], node.low_y[1]),
                           uvec2(node.low_z[0], node.low_z[1]));
    uvec2 high[3] = uvec2[](uvec2(node.high_x[0], node.high_x[1]), uvec2(node.high_y[0], node.high_y[1]),
                            uvec2(node.high_z[0], node.high_z[1]));
    // Along each axis, a ray with a positive direction enters at the lower bound and
    // leaves at the upper bound. With a negative direction, it is the opposite.
    uvec2 near[3], far[3];
    [[unroll]] for (uint c = 0u; c < 3u; ++c) {
        near[c] = ray.inverse[c] < 0.0 ? high[c] : low[c];
        far[c] = ray.inverse[c] < 0.0 ? low[c] : high[c];
    }
    uint met = 0u;
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) {
        vec3 enter =
            vec3(unpack_byte(near[0], slot), unpack_byte(near[1], slot), unpack_byte(near[2], slot)) * scale +
            near_at;
        vec3 leave =
            vec3(unpack_byte(far[0], slot), unpack_byte(far[1], slot), unpack_byte(far[2], slot)) * scale +
            far_at;
        t[slot] = max(max(enter.x, enter.y), max(enter.z, ray.start));
        float last = min(min(leave.x, leave.y), min(leave.z, ray.end));
        // A comparison with NaN is false, so a box with undefined distances is visited.
        if (!(t[slot] > last)) met |= 1u << slot;
    }
    return met;
}

void push_entry(uint entry, float t) {
    stack_full = stack_full || stack_size == kStackSize;
    if (stack_full) return;
    stack_entry[stack_size] = entry;
    stack_t[stack_size] = t;
    ++stack_size;
}

/// Pushes the inner children that a ray must visit onto the stack, the nearest on top.
/// Packs index and distance of a child into one integer, so that the sorting network
/// needs only minima and maxima. The packed distance loses four bits and is rounded
/// towards the ray's origin.
/// @param first_inner_child stack entry of the first inner child
void push_ray_children(uint first_inner_child, uint inner_mask, uint hit_mask, float t[RELIDAR_BVH_WIDTH]) {
    const uint kIsHitFlag = 0x80000000u;
    uint key[RELIDAR_BVH_WIDTH];
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) key[slot] =
        (inner_mask & hit_mask & (1u << slot)) != 0u
            ? ((floatBitsToUint(t[slot]) >> 1u) & ~7u) | kIsHitFlag | slot
            : 0u;
    // Sorting network for 8 keys: 19 pairs that are compared and exchanged.
    const uint kSortingNetworkPairs[38] =
        uint[](0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 0u, 2u, 1u, 3u, 4u, 6u, 5u, 7u, 1u, 2u, 5u, 6u, 0u, 4u, 3u, 7u,
               1u, 5u, 2u, 6u, 1u, 4u, 3u, 6u, 2u, 4u, 3u, 5u, 3u, 4u);
    [[unroll]] for (uint k = 0u; k < 38u; k += 2u) {
        uint a = key[kSortingNetworkPairs[k]], b = key[kSortingNetworkPairs[k + 1u]];
        key[kSortingNetworkPairs[k]] = max(a, b);
        key[kSortingNetworkPairs[k + 1u]] = min(a, b);
    }
    [[unroll]] for (uint k = 0u; k < RELIDAR_BVH_WIDTH; ++k) {
        if (key[k] == 0u) break;
        uint slot = key[k] & 7u;
        push_entry(first_inner_child + bitCount(inner_mask & ((1u << slot) - 1u)),
                   uintBitsToFloat((key[k] & ~(kIsHitFlag | 7u)) << 1u));
    }
}

/// Pushes the child nodes whose boxes are hit by any ray of the subgroup onto the stack.
/// All rays push the same nodes in the same order: from far to near, as seen from the
/// first active ray.
void push_group_children(uint first_inner_child, uint inner_mask, uint subgroup_hit_mask, uint ray_hit_mask,
                         float t[RELIDAR_BVH_WIDTH]) {
    float key[RELIDAR_BVH_WIDTH];
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) key[slot] =
        subgroupBroadcastFirst(t[slot]);
    uint left = inner_mask & subgroup_hit_mask;
    if (left == 0u) return;
    do {
        uint farthest = uint(findLSB(left));
        float farthest_key = -1.0, own = kNoHit_t;
        [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH;
                        ++slot) if ((left & (1u << slot)) != 0u && key[slot] > farthest_key) {
            farthest = slot;
            farthest_key = key[slot];
            own = t[slot];
        }
        left &= ~(1u << farthest);
        push_entry(first_inner_child + bitCount(inner_mask & ((1u << farthest) - 1u)),
                   (ray_hit_mask & (1u << farthest)) != 0u ? own : kNoHit_t);
    } while (left != 0u);
}

/// Returns a bit mask of the leaf entries that must be tested (surfels, or instances in
/// the top-level tree).
/// @param child_mask bit mask of the children that a ray intersects
uint leaf_entry_mask(BvhNode node, uint child_mask) {
    uvec2 leaves = uvec2(node.leaves[0], node.leaves[1]);
    uint entries = 0u;
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) {
        uint leaf = unpack_byte(leaves, slot);
        if ((child_mask & (1u << slot)) != 0u) entries |= ((1u << (leaf >> 5u)) - 1u) << (leaf & 31u);
    }
    return entries;
}

/// Clears the lowest set bit of a bit mask, and returns the index of this bit.
uint pop_lowest_bit(inout uint bit_mask) {
    uint lowest = uint(findLSB(bit_mask));
    bit_mask &= bit_mask - 1u;
    return lowest;
}

/// Returns true if the lanes of the subgroup may load data together. All lanes must be
/// active for this.
bool can_share_loads() {
    return TOGETHER == kSharesLoads && subgroupBallotBitCount(subgroupBallot(true)) == gl_SubgroupSize;
}

/// Tests surfels in the leaves of one tree node against the rays of all lanes. Ignores
/// hits that do not come after `previous_key`.
/// @param entry_mask bit k selects leaf entry first_leaf_entry + k. Equal in all lanes
void intersect_leaf_shared(TraceScene scene, HitKey previous_key, uint instance, uint first_surfel,
                           uint first_leaf_entry, uint entry_mask) {
    if (entry_mask == 0u) return;
    do {  // one iteration per block of gl_SubgroupSize entries
        uint first = uint(findLSB(entry_mask)) / gl_SubgroupSize * gl_SubgroupSize,
             end = min(first + gl_SubgroupSize, 32u);
        uint own = first + gl_SubgroupInvocationID, lane_surfel = 0u;
        float lane_x = 0.0;
        if (own < end && (entry_mask & (1u << own)) != 0u) {
            lane_surfel = first_surfel + scene.bvh.order.at[first_leaf_entry + own];
            // Each lane reads one float of a different record, so that the cache misses
            // of all records overlap.
            lane_x = scene.records.at[lane_surfel].mean.x;
        }
        do {
            uint lane = pop_lowest_bit(entry_mask) - first, surfel = subgroupShuffle(lane_surfel, lane);
            SurfelRecord record = load_record(scene.records, surfel);
            record.mean.x = subgroupShuffle(lane_x, lane);
            test_record(scene, previous_key, instance, surfel, record);
        } while (entry_mask != 0u && uint(findLSB(entry_mask)) < end);
    } while (entry_mask != 0u);
}

/// Tests surfels in the leaves of a node against one ray. Loads the next record before it
/// tests the current one, to hide the latency of the load.
void intersect_leaf(TraceScene scene, HitKey previous_key, uint instance, uint first_leaf_entry,
                    uint entry_mask) {
    while (entry_mask != 0u) {
        uint entry = first_leaf_entry + pop_lowest_bit(entry_mask),
             next_entry = entry_mask != 0u ? first_leaf_entry + uint(findLSB(entry_mask)) : entry;
        uint surfel = entered_first_surfel + scene.bvh.order.at[entry],
             next_surfel = entered_first_surfel + scene.bvh.order.at[next_entry];
        SurfelRecord record = scene.records.at[surfel], next_record = scene.records.at[next_surfel];
        test_record(scene, previous_key, instance, surfel, record);
        if (entry_mask == 0u) return;
        entry_mask &= entry_mask - 1u;
        test_record(scene, previous_key, instance, next_surfel, next_record);
    }
}

/// Transforms the ray into the frame of an instance's model for box tests. For the
/// top-level tree, uses the ray in the world frame.
void transform_box_ray(TraceScene scene, Ray ray, uint instance, inout BoxRay box_ray) {
    if (instance != RELIDAR_BVH_NO_NODE) enter_instance(scene, ray, instance);
    bool in_model = instance != RELIDAR_BVH_NO_NODE;
    prepare_box_ray(box_ray, in_model ? entered_origin : ray.origin,
                    in_model ? entered_direction : ray.direction);
}

/// Visits a node: tests the surfels in its leaves and pushes its child nodes onto the
/// stack.
/// @param tree_instance instance of the tree, or RELIDAR_BVH_NO_NODE for the top-level
/// tree
/// @param is_subgroup_full true if all lanes are active. They then load the node together
/// @return number of tested surfels
uint visit_node(TraceScene scene, Ray ray, HitKey previous_key, uint tree_instance, uint node_index,
                bool is_subgroup_full, inout BoxRay box_ray) {
    bool in_model = tree_instance != RELIDAR_BVH_NO_NODE;
    BvhNodes nodes = in_model ? scene.bvh.nodes : scene.bvh.top_nodes;
    BvhNode node;
    if (is_subgroup_full) node = load_node(nodes, node_index);
    else node = nodes.at[node_index];
    float t[RELIDAR_BVH_WIDTH];
    uint met = intersect_boxes(node, box_ray, t);
    uint child_mask = TOGETHER != 0u ? subgroupOr(met) : met;
    uint entry_mask = leaf_entry_mask(node, child_mask);
    uint first = node.first_child | (in_model ? 0u : kTopEntry), inner = node.exponents >> 24u;
    if (TOGETHER != 0u) push_group_children(first, inner, child_mask, met, t);
    else push_ray_children(first, inner, met, t);
    if (!in_model) {
        while (entry_mask != 0u)
            push_entry(kInstanceEntry | scene.bvh.top_order.at[node.first_leaf + pop_lowest_bit(entry_mask)],
                       box_ray.start);
        return 0u;
    }
    uint n_tested = uint(bitCount(entry_mask)),
         first_surfel = TOGETHER != 0u ? subgroupBroadcastFirst(entered_first_surfel) : entered_first_surfel;
    if (is_subgroup_full) {
        intersect_leaf_shared(scene, previous_key, tree_instance, first_surfel, node.first_leaf, entry_mask);
    } else if (TOGETHER != 0u) {
        while (entry_mask != 0u)
            test_surfel(scene, previous_key, tree_instance,
                        first_surfel + scene.bvh.order.at[node.first_leaf + pop_lowest_bit(entry_mask)]);
    } else {
        intersect_leaf(scene, previous_key, tree_instance, node.first_leaf, entry_mask);
    }
    // Boxes behind the farthest needed hit can be skipped from now on. The margin covers
    // the rounding error of t.
    if (hits_closed) box_ray.end = last_hit_t() + (1e-4 + 1e-5 * last_hit_t());
    return n_tested;
}

/// Finds the hits of a ray behind `previous_key` and passes them to the hit buffer.
/// Starts at the root of the top-level tree, and skips entries that are behind the last
/// needed hit.
void find_hits(TraceScene scene, Ray ray, HitKey previous_key) {
    BoxRay box_ray;
    box_ray.start = search_start_t(previous_key);
    box_ray.end = kNoHit_t;
    // Instance whose model the ray currently traverses, or RELIDAR_BVH_NO_NODE for the
    // top-level tree.
    uint instance = RELIDAR_BVH_NO_NODE;
    uint n_nodes = 0u, n_tested = 0u;
    bool is_subgroup_full = can_share_loads();
    transform_box_ray(scene, ray, instance, box_ray);
    stack_size = 0u;
    stack_full = false;
    push_entry(kTopEntry, box_ray.start);
    while (stack_size > 0u) {
        uint entry = stack_entry[stack_size - 1u], tree = instance;
        if (TOGETHER != 0u) {
            uint lane_entry = entry;
            entry = subgroupBroadcastFirst(entry);
            tree = subgroupBroadcastFirst(tree);
            // Each lane has a stack of tree nodes to visit. The subgroup visits the top
            // node of its first active lane. Lanes with another top node wait.
            if (lane_entry != entry || instance != tree) continue;
        }
        --stack_size;
        bool is_needed = stack_t[stack_size] <= box_ray.end;
        if (!(TOGETHER != 0u ? subgroupAny(is_needed) : is_needed)) continue;
        if ((entry & kInstanceEntry) != 0u) {
            tree = entry & ~kInstanceEntry;
            entry = scene.bvh.roots.at[tree];
            if (entry == RELIDAR_BVH_NO_NODE) continue;
        } else if ((entry & kTopEntry) != 0u) {
            tree = RELIDAR_BVH_NO_NODE;
        }
        if (tree != instance) transform_box_ray(scene, ray, tree, box_ray);
        instance = tree;
        ++n_nodes;
        n_tested += visit_node(scene, ray, previous_key, tree, entry & ~kTopEntry, is_subgroup_full, box_ray);
    }
    if (stack_full) atomicAdd(scene.pass_cap_count.at[0], 1u);
    if (COUNT_VISITS != 0u) {
        atomicAdd(scene.visits.at[0], n_nodes);
        atomicAdd(scene.visits.at[1], n_tested);
    }
}
#endif
