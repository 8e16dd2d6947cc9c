// SPDX-License-Identifier: Apache-2.0
// Builds binary trees by agglomerative clustering (Benthin et al., "H-PLOC: Hierarchical
// Parallel Locally-Ordered Clustering", 2024).
//
// A radix tree over the sorted keys determines which neighbouring ranges are joined (as
// in Apetrei 2014). A join reduces the at most 32 clusters of two ranges to at most 16 by
// merging mutual nearest neighbours, searched among 8 clusters on either side. One thread
// per sorted position. The second thread that reaches a split continues upwards. A
// workgroup is one subgroup, because a subgroup barrier stops the full workgroup on
// lavapipe. Nodes are numbered by sorted positions, so that builds are repeatable.
// Input: boxes, keys, surfels, models. Output: tree, roots.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../../scene/find_model.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_binary.glsl"
#include "bvh_merge.glsl"
RELIDAR_PARAMS(BvhClusterParams);

// KEPT: maximum number of clusters after a join. RADIUS: neighbours searched per side.
const uint KEPT = 16u, ROOM = 2u * KEPT, RADIUS = 8u;
struct Cluster {
    Box box;
    uint root;   // node or leaf
    uint spare;  // Sorted position in this subtree that no node uses as its index yet.
};
// Subtrees (clusters) that are being merged, as one array per field.
shared vec3 low_of[ROOM], high_of[ROOM];
shared uint root_of[ROOM], spare_of[ROOM];
shared uint nearest[ROOM];
// Two neighbouring ranges of sorted surfels whose subtrees are merged next: surfels
// task.x to task.y, and task.y + 1 to task.z. task.w is the index of a model if both
// ranges together are the complete model, otherwise -1.
shared ivec4 task;

void sync_subgroup() {
    subgroupMemoryBarrierShared();
    subgroupBarrier();
}

/// Returns the number of equal leading bits in the Morton codes of surfel `position` and
/// the next surfel. Returns -1 unless both are in the range `model_first` ...
/// `model_last`.
int common_prefix(int position, int model_first, int model_last) {
    if (position < model_first || position >= model_last) return -1;
    uvec2 a = params.keys.at[position], b = params.keys.at[position + 1];
    // Compares codes, then positions, so that equal codes have an order.
    if (a.y != b.y) return 31 - findMSB(a.y ^ b.y);
    if (a.x != b.x) return 63 - findMSB(a.x ^ b.x);
    return 95 - findMSB(uint(position ^ (position + 1)));
}

Box box_at(uint index) { return Box(low_of[index], high_of[index]); }

Cluster cluster_at(uint index) { return Cluster(box_at(index), root_of[index], spare_of[index]); }

void store_cluster(uint index, Cluster cluster) {
    low_of[index] = cluster.box.low;
    high_of[index] = cluster.box.high;
    root_of[index] = cluster.root;
    spare_of[index] = cluster.spare;
}

/// Loads a subtree. The first spare position of a single surfel is its own position.
Cluster load_cluster(uint root) {
    if (is_leaf(root)) {
        uint position = root & ~RELIDAR_BVH_LEAF;
        return Cluster(load_box(params.boxes, params.surfels.at[position]), root, position);
    }
    return Cluster(load_shared_box(params.tree.boxes, root), root,
                   SharedUints(uvec2(params.tree.spares)).at[root]);
}

/// Loads the clusters (subtrees) of the sorted surfels `range_first` ... `range_last`.
/// Appends them to the `n_clusters` clusters in shared memory. Returns their new number.
uint append_range(int range_first, int range_last, uint n_clusters) {
    SharedUints roots = SharedUints(uvec2(params.clusters));
    uint n_range = min(uint(range_last - range_first) + 1u, KEPT);
    for (uint start = 0u; start < n_range; start += gl_SubgroupSize) {
        uint k = start + gl_SubgroupInvocationID;
        uint root = k < n_range ? roots.at[range_first + k] : RELIDAR_BVH_NO_NODE;
        uint end = subgroupMin(root == RELIDAR_BVH_NO_NODE ? k : n_range);
        if (k < end) store_cluster(n_clusters + k, load_cluster(root));
        if (end < start + gl_SubgroupSize) return n_clusters + min(end, n_range);
    }
    return n_clusters + n_range;
}

/// Returns the cluster whose joint bounding box with `cluster` has the smallest
/// surface area. If several areas are equal, returns the first of these clusters. This
/// rule guarantees that at least two clusters choose each other and can be merged.
uint find_nearest(uint cluster, uint n_clusters) {
    Box box = box_at(cluster);
    float least = BOX_HUGE;
    uint neighbour = cluster;
    for (uint j = cluster - min(cluster, RADIUS); j < min(cluster + RADIUS + 1u, n_clusters); ++j) {
        float area = half_area(join_boxes(box, box_at(j)));
        if (j == cluster || !(area < least)) continue;
        least = area;
        neighbour = j;
    }
    return neighbour;
}

/// Creates a binary node with two children. Its index is a sorted position of the second
/// cluster, so that indices do not depend on the order of threads.
Cluster merge_clusters(Cluster first, Cluster second) {
    uint node = second.spare;
    Box box = join_boxes(first.box, second.box);
    store_box(params.tree.boxes, node, box);
    SharedUints(uvec2(params.tree.spares)).at[node] = first.spare;
    params.tree.children.at[node] = uvec2(first.root, second.root);
    write_costs(params.tree, node, Subtree(first.root, half_area(first.box)),
                Subtree(second.root, half_area(second.box)), half_area(box));
    return Cluster(box, node, first.spare);
}

/// Merges each pair of clusters that are mutual nearest neighbours.
/// @return number of remaining clusters
uint merge_nearest(uint count) {
    for (uint i = gl_SubgroupInvocationID; i < count; i += gl_SubgroupSize)
        nearest[i] = find_nearest(i, count);
    sync_subgroup();
    uint n_kept = 0u;
    for (uint start = 0u; start < count; start += gl_SubgroupSize) {
        uint i = start + gl_SubgroupInvocationID;
        uint j = i < count ? nearest[i] : 0u;
        // The cluster with the lower index of a pair stays, and the other one disappears.
        bool mutual = i < count && nearest[j] == i, kept = i < count && !(mutual && j < i);
        Cluster c;
        if (kept) c = cluster_at(i);
        if (kept && mutual) c = merge_clusters(c, cluster_at(j));
        sync_subgroup();
        uvec2 lanes = subgroupBallot(kept).xy, before = lanes & gl_SubgroupLtMask.xy;
        // Removes gaps between the clusters in shared memory. A cluster never overwrites
        // an unread cluster, because it can only move to a lower index.
        if (kept) store_cluster(n_kept + uint(bitCount(before.x) + bitCount(before.y)), c);
        n_kept += uint(bitCount(lanes.x) + bitCount(lanes.y));
    }
    memoryBarrierBuffer();  // later merges read these nodes
    sync_subgroup();
    return n_kept;
}

/// Merges the subtrees of the two surfel ranges in `task` until at most KEPT = 16
/// subtrees remain. If the ranges are a complete model, continues until one subtree
/// remains. All threads of the subgroup must call this function.
void merge_ranges() {
    uint n = append_range(task.x, task.y, 0u);
    n = append_range(task.y + 1, task.z, n);
    sync_subgroup();
    bool covers_model = task.w >= 0;
    while (n > (covers_model ? 1u : KEPT)) n = merge_nearest(n);
    if (covers_model) {
        if (gl_SubgroupInvocationID == 0u) params.roots.at[task.w] = root_of[0];
        return;
    }
    SharedUints roots = SharedUints(uvec2(params.clusters));
    for (uint k = gl_SubgroupInvocationID; k < n; k += gl_SubgroupSize) roots.at[task.x + k] = root_of[k];
    if (n < KEPT && gl_SubgroupInvocationID == 0u) roots.at[task.x + n] = RELIDAR_BVH_NO_NODE;
}

/// Joins two neighbouring ranges of sorted surfels that meet behind surfel `split`. Each
/// range (`range_first` ... `range_last`) belongs to one thread, and both threads call
/// this function. The model has the surfels `model_first` ... `model_last`.
/// @return false for the first caller, which stops. True for the second caller, which
/// continues with the joined range `range_first` ... `range_last`
bool join_sibling(inout int range_first, inout int range_last, out int split, int model_first,
                  int model_last) {
    // Joins the neighbour with which the range shares more leading bits (radix tree).
    bool leftward = common_prefix(range_first - 1, model_first, model_last) >
                    common_prefix(range_last, model_first, model_last);
    split = leftward ? range_first - 1 : range_last;
    uint other = atomicExchange(SharedUints(uvec2(params.other_ends)).at[split],
                                uint(leftward ? range_last : range_first));
    if (other == RELIDAR_BVH_NO_NODE) return false;
    if (leftward) range_first = int(other);
    else range_last = int(other);
    return true;
}

void main() {
    uint position = thread_index();
    bool climbing = position < params.n_surfels;
    int model = climbing ? int(find_model(params.models, params.n_models, position)) : 0;
    int first = int(params.models.at[model].first_surfel),
        last = first + int(params.models.at[model].n_surfels) - 1;
    int from = int(position), to = from, split = from;
    if (climbing) SharedUints(uvec2(params.clusters)).at[position] = position | RELIDAR_BVH_LEAF;
    if (climbing && first == last) {
        params.roots.at[model] = position | RELIDAR_BVH_LEAF;
        climbing = false;
    }
    // All lanes stay in the loop, because merge_ranges() needs the full subgroup.
    while (subgroupAny(climbing)) {
        memoryBarrierBuffer();
        if (climbing) climbing = join_sibling(from, to, split, first, last);
        memoryBarrierBuffer();
        // Short ranges are not merged, because all their surfels fit into KEPT clusters.
        bool covers_model = from == first && to == last,
             waiting = climbing && (covers_model || to - from >= int(KEPT));
        // Lanes take turns. The full subgroup merges the ranges of one lane.
        while (subgroupAny(waiting)) {
            uint first_lane = subgroupMin(waiting ? gl_SubgroupInvocationID : 0xffffffffu);
            bool next = gl_SubgroupInvocationID == first_lane;
            if (next) task = ivec4(from, split, to, covers_model ? model : -1);
            sync_subgroup();
            merge_ranges();
            sync_subgroup();
            if (next) waiting = false;
        }
        if (covers_model) climbing = false;
    }
}
