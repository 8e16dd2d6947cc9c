// SPDX-License-Identifier: Apache-2.0
// Backend: a two-level tree of wide nodes with quantised boxes (shared/bvh.h), walked
// with a stack, near children first. The top tree holds instances; an instance's entry
// moves the ray into its model's frame until an entry of the top tree is met again. Two
// ways, by specialisation: each ray on its own, or the rays of a subgroup together, which
// open a node if any of them needs it and test its surfels all at once. Together, every
// ray still keeps its own stack and its own distances, and takes the union of what its
// subgroup wants. Rays take the same entry at a time, that of the first of them, and one
// whose stack has come to differ waits for its turn: so nothing is missing however a
// driver lets lanes part and meet, and what is loaded has the same address in all lanes,
// as a broadcast tells the compiler, which then loads it once. A CPU's compiler does not,
// so there lanes load for each other (kSharesLoads, shared_load.glsl): its lanes are
// those of one vector, and cannot part. Where all are there at the start they have the
// same stack until the end. Its compiler also runs through a loop once more, without a
// lane, to find out that none goes on: loops of few turns test at their end.
//
// No hit is lost:
// - The slab test uses the very ray that intersect() uses (entered_origin,
//   entered_direction). t is the ray's parameter, the same in the world and in a model
//   whatever the instance's scale, so distances of all trees compare with the canonical
//   t.
// - A slab distance q scale + at is off by at most 8 roundings of its terms; kSlack times
//   both terms moves near planes nearer and far planes farther by more than that.
// - A direction component of less than kLeastSlope is taken as that: over 100 km the ray
//   is off by 10^-7 m, less than the slack. So no division by zero and, for coordinates
//   under 10^25 m, no NaN; the comparisons open a node should there be one.
// - A model that moves is in its box of the top tree whenever a ray is fired: the box
//   holds all that the model sweeps in its span, and a ray's time is clamped to that span
//   (enter_instance()).
// - A node is left out behind `end` and before `start` only. Both keep 1e-4 m + 1e-5 t
//   for the rounding of the canonical t, as every backend's (README.md).
//
// What it costs on a GPU: a node is 80 bytes and about 150 operations for eight boxes; a
// surfel 64 bytes and 40 operations.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SOFTWARE_BVH_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SOFTWARE_BVH_GLSL
#extension GL_KHR_shader_subgroup_basic : enable
#extension GL_KHR_shader_subgroup_vote : enable
#extension GL_KHR_shader_subgroup_ballot : enable
#extension GL_KHR_shader_subgroup_arithmetic : enable
#extension GL_KHR_shader_subgroup_shuffle : enable
#include "shared_load.glsl"
RELIDAR_CONSTANT(uint, TOGETHER, 0u);
const uint kSharesLoads = 2u;
RELIDAR_CONSTANT(uint, COUNT_VISITS, 0u);

// At most 7 entries stay behind a level: enough for 9 levels of full nodes, 8^9 surfels.
// A tree as deep and as wide as to need more makes the ray end early, and be counted as
// an error.
const uint kStackSize = 64u;
const uint kInstanceEntry = 0x80000000u;  // entries of instances
// nodes of the top tree; others are nodes of the instance that was entered last
const uint kTopEntry = 0x40000000u;
const float kNever = 1e30;
const float kSlack = 5e-7;  // 8 roundings of 2^-24
const float kLeastSlope = 1e-12;

uint stack_entry[SLOTS];  // SLOTS is one more than what is used
float stack_t[SLOTS];     // where this ray enters it, kNever where it does not
uint stack_size;
bool stack_full;

/// A ray as boxes are tested with it, in the frame of the tree that is being walked.
struct BoxRay {
    vec3 origin;
    vec3 inverse;  // of the direction
    float start;   // m along the ray: boxes before and behind are left out
    float end;
};

void set_box_ray(inout BoxRay ray, vec3 origin, vec3 direction) {
    vec3 least = mix(vec3(kLeastSlope), vec3(-kLeastSlope), lessThan(direction, vec3(0.0)));
    ray.origin = origin;
    ray.inverse = 1.0 / mix(direction, least, lessThan(abs(direction), vec3(kLeastSlope)));
}

uint byte_of(uvec2 bytes, uint slot) {
    return ((slot < 4u ? bytes.x : bytes.y) >> (8u * (slot & 3u))) & 255u;
}

/// @param t  output: where the ray enters the box of each slot, if it does
/// @return a bit a slot whose box the ray meets within [start, end]; empty slots may be
/// among them
uint meet_boxes(BvhNode node, BoxRay ray, out float t[RELIDAR_BVH_WIDTH]) {
    vec3 scale =
        uintBitsToFloat((uvec3(node.exponents, node.exponents >> 8u, node.exponents >> 16u) & 255u) << 23u) *
        ray.inverse;
    vec3 at = (node.origin - ray.origin) * ray.inverse;
    vec3 slack = kSlack * (abs(at) + 255.0 * abs(scale));
    vec3 near_at = at - slack, far_at = at + slack;
    uvec2 low[3] = uvec2[](uvec2(node.low_x[0], node.low_x[1]), uvec2(node.low_y[0], node.low_y[1]),
                           uvec2(node.low_z[0], node.low_z[1]));
    uvec2 high[3] = uvec2[](uvec2(node.high_x[0], node.high_x[1]), uvec2(node.high_y[0], node.high_y[1]),
                            uvec2(node.high_z[0], node.high_z[1]));
    uvec2 near[3], far[3];
    [[unroll]] for (uint c = 0u; c < 3u; ++c) {
        near[c] = ray.inverse[c] < 0.0 ? high[c] : low[c];
        far[c] = ray.inverse[c] < 0.0 ? low[c] : high[c];
    }
    uint met = 0u;
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) {
        vec3 enter =
            vec3(byte_of(near[0], slot), byte_of(near[1], slot), byte_of(near[2], slot)) * scale + near_at;
        vec3 leave =
            vec3(byte_of(far[0], slot), byte_of(far[1], slot), byte_of(far[2], slot)) * scale + far_at;
        t[slot] = max(max(enter.x, enter.y), max(enter.z, ray.start));
        float last = min(min(leave.x, leave.y), min(leave.z, ray.end));
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

/// Puts the inner slots that a ray is to open on its stack, the nearest on top. A slot
/// and where the ray enters it are one number: so the network that orders eight of them
/// is of minima and maxima alone. The distance loses four bits, towards the ray's origin.
/// @param first  entry of the first inner slot
void push_own_children(uint first, uint inner, uint met, float t[RELIDAR_BVH_WIDTH]) {
    const uint kThere = 0x80000000u;
    uint key[RELIDAR_BVH_WIDTH];
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) key[slot] =
        (inner & met & (1u << slot)) != 0u ? ((floatBitsToUint(t[slot]) >> 1u) & ~7u) | kThere | slot : 0u;
    const uint kPairs[38] =
        uint[](0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 0u, 2u, 1u, 3u, 4u, 6u, 5u, 7u, 1u, 2u, 5u, 6u, 0u, 4u, 3u, 7u,
               1u, 5u, 2u, 6u, 1u, 4u, 3u, 6u, 2u, 4u, 3u, 5u, 3u, 4u);
    [[unroll]] for (uint k = 0u; k < 38u; k += 2u) {
        uint a = key[kPairs[k]], b = key[kPairs[k + 1u]];
        key[kPairs[k]] = max(a, b);
        key[kPairs[k + 1u]] = min(a, b);
    }
    [[unroll]] for (uint k = 0u; k < RELIDAR_BVH_WIDTH; ++k) {
        if (key[k] == 0u) break;
        uint slot = key[k] & 7u;
        push_entry(first + bitCount(inner & ((1u << slot) - 1u)),
                   uintBitsToFloat((key[k] & ~(kThere | 7u)) << 1u));
    }
}

/// The same for rays that walk together, which open what any of them meets, in the order
/// of the subgroup's first ray.
void push_children(uint first, uint inner, uint opened, uint met, float t[RELIDAR_BVH_WIDTH]) {
    float key[RELIDAR_BVH_WIDTH];
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) key[slot] =
        subgroupBroadcastFirst(t[slot]);
    uint left = inner & opened;
    if (left == 0u) return;
    do {
        uint farthest = uint(findLSB(left));
        float farthest_key = -1.0, own = kNever;
        [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH;
                        ++slot) if ((left & (1u << slot)) != 0u && key[slot] > farthest_key) {
            farthest = slot;
            farthest_key = key[slot];
            own = t[slot];
        }
        left &= ~(1u << farthest);
        push_entry(first + bitCount(inner & ((1u << farthest) - 1u)),
                   (met & (1u << farthest)) != 0u ? own : kNever);
    } while (left != 0u);
}

/// @return a bit for every entry of `order`, from the node's first on, that lies in an
/// opened leaf slot
uint leaf_entries(BvhNode node, uint opened) {
    uvec2 leaves = uvec2(node.leaves[0], node.leaves[1]);
    uint entries = 0u;
    [[unroll]] for (uint slot = 0u; slot < RELIDAR_BVH_WIDTH; ++slot) {
        uint leaf = byte_of(leaves, slot);
        if ((opened & (1u << slot)) != 0u) entries |= ((1u << (leaf >> 5u)) - 1u) << (leaf & 31u);
    }
    return entries;
}

/// Takes the lowest entry out of a set. @return its index
uint take_lowest(inout uint entries) {
    uint lowest = uint(findLSB(entries));
    entries &= entries - 1u;
    return lowest;
}

/// Whether the lanes of this subgroup load for each other: some may be missing at the end
/// of a batch, or have ended before the others.
bool shares_loads() {
    return TOGETHER == kSharesLoads && subgroupBallotBitCount(subgroupBallot(true)) == gl_SubgroupSize;
}

/// Offers opened entries to the rays of a whole subgroup. @param entries  the same in all
/// lanes
void offer_together(TraceScene scene, Key after, uint instance, uint first_surfel, uint first_leaf,
                    uint entries) {
    if (entries == 0u) return;
    do {  // as many entries as there are lanes
        uint first = uint(findLSB(entries)) / gl_SubgroupSize * gl_SubgroupSize,
             end = min(first + gl_SubgroupSize, 32u);
        uint own = first + gl_SubgroupInvocationID, own_surfel = 0u;
        float own_x = 0.0;
        if (own < end && (entries & (1u << own)) != 0u) {
            own_surfel = first_surfel + scene.bvh.order.at[first_leaf + own];
            // each lane another record: misses of the cache overlap
            own_x = scene.records.at[own_surfel].mean.x;
        }
        do {
            uint lane = take_lowest(entries) - first, surfel = subgroupShuffle(own_surfel, lane);
            SurfelRecord record = load_record(scene.records, surfel);
            record.mean.x = subgroupShuffle(own_x, lane);
            offer_record(scene, after, instance, surfel, record);
        } while (entries != 0u && uint(findLSB(entries)) < end);
    } while (entries != 0u);
}

/// Offers opened entries to a ray that walks on its own. The record of the next one is on
/// its way while one is tested.
void offer_alone(TraceScene scene, Key after, uint instance, uint first_leaf, uint entries) {
    while (entries != 0u) {
        uint entry = first_leaf + take_lowest(entries),
             next_entry = entries != 0u ? first_leaf + uint(findLSB(entries)) : entry;
        uint surfel = entered_first_surfel + scene.bvh.order.at[entry],
             next_surfel = entered_first_surfel + scene.bvh.order.at[next_entry];
        SurfelRecord record = scene.records.at[surfel], next_record = scene.records.at[next_surfel];
        offer_record(scene, after, instance, surfel, record);
        if (entries == 0u) return;
        entries &= entries - 1u;
        offer_record(scene, after, instance, next_surfel, next_record);
    }
}

/// Moves the boxes' ray to the frame of an instance's model, or of the world.
void enter_tree(TraceScene scene, Ray ray, uint instance, inout BoxRay walked) {
    if (instance != RELIDAR_BVH_NO_NODE) enter_instance(scene, ray, instance);
    bool in_model = instance != RELIDAR_BVH_NO_NODE;
    set_box_ray(walked, in_model ? entered_origin : ray.origin, in_model ? entered_direction : ray.direction);
}

/// Opens a node: leaves are offered, inner slots go on the stack.
/// @param tree  instance whose model the node belongs to; none: the top tree @param whole
/// shares_loads() @return surfels tested
uint open_node(TraceScene scene, Ray ray, Key after, uint tree, uint index, bool whole, inout BoxRay walked) {
    bool in_model = tree != RELIDAR_BVH_NO_NODE;
    BvhNodes nodes = in_model ? scene.bvh.nodes : scene.bvh.top_nodes;
    BvhNode node;
    if (whole) node = load_node(nodes, index);
    else node = nodes.at[index];
    float t[RELIDAR_BVH_WIDTH];
    uint met = meet_boxes(node, walked, t);
    uint opened = TOGETHER != 0u ? subgroupOr(met) : met;
    uint entries = leaf_entries(node, opened);
    uint first = node.first_child | (in_model ? 0u : kTopEntry), inner = node.exponents >> 24u;
    if (TOGETHER != 0u) push_children(first, inner, opened, met, t);
    else push_own_children(first, inner, met, t);
    if (!in_model) {
        while (entries != 0u)
            push_entry(kInstanceEntry | scene.bvh.top_order.at[node.first_leaf + take_lowest(entries)],
                       walked.start);
        return 0u;
    }
    uint n_tested = uint(bitCount(entries)),
         first_surfel = TOGETHER != 0u ? subgroupBroadcastFirst(entered_first_surfel) : entered_first_surfel;
    if (whole) {
        offer_together(scene, after, tree, first_surfel, node.first_leaf, entries);
    } else if (TOGETHER != 0u) {
        while (entries != 0u)
            offer_surfel(scene, after, tree,
                         first_surfel + scene.bvh.order.at[node.first_leaf + take_lowest(entries)]);
    } else {
        offer_alone(scene, after, tree, node.first_leaf, entries);
    }
    if (hits_closed) walked.end = last_hit_t() + (1e-4 + 1e-5 * last_hit_t());
    return n_tested;
}

void find_hits(TraceScene scene, Ray ray, Key after) {
    BoxRay walked;
    walked.start = search_start(after);
    walked.end = kNever;
    uint instance = RELIDAR_BVH_NO_NODE;  // whose model is being walked; none: the top tree
    uint n_nodes = 0u, n_tested = 0u;
    bool whole = shares_loads();
    enter_tree(scene, ray, instance, walked);
    stack_size = 0u;
    stack_full = false;
    push_entry(kTopEntry, walked.start);
    while (stack_size > 0u) {
        uint entry = stack_entry[stack_size - 1u], tree = instance;
        if (TOGETHER != 0u) {
            uint own_entry = entry;
            entry = subgroupBroadcastFirst(entry);
            tree = subgroupBroadcastFirst(tree);
            if (own_entry != entry || instance != tree) continue;  // not its turn
        }
        --stack_size;
        bool wanted = stack_t[stack_size] <= walked.end;
        if (!(TOGETHER != 0u ? subgroupAny(wanted) : wanted)) continue;
        if ((entry & kInstanceEntry) != 0u) {
            tree = entry & ~kInstanceEntry;
            entry = scene.bvh.roots.at[tree];
            if (entry == RELIDAR_BVH_NO_NODE) continue;
        } else if ((entry & kTopEntry) != 0u) {
            tree = RELIDAR_BVH_NO_NODE;
        }
        if (tree != instance) enter_tree(scene, ray, tree, walked);
        instance = tree;
        ++n_nodes;
        n_tested += open_node(scene, ray, after, tree, entry & ~kTopEntry, whole, walked);
    }
    if (stack_full) atomicAdd(scene.pass_cap_count.at[0], 1u);
    if (COUNT_VISITS != 0u) {
        atomicAdd(scene.visits.at[0], n_nodes);
        atomicAdd(scene.visits.at[1], n_tested);
    }
}
#endif
