// SPDX-License-Identifier: Apache-2.0
// Binary trees by agglomeration (Benthin et al., "H-PLOC: Hierarchical Parallel Locally-Ordered Clustering", 2024): the radix tree over
// the sorted keys (after Apetrei 2014, ends of ranges exchanged at splits) says which ranges come together; where two do, their at
// most 32 clusters are merged to at most 16, each with its nearest of the 8 next to it where that is mutual. Costs of wide nodes are
// found with each merge. One thread a sorted position; the second to reach a split goes on. Input: boxes, keys, surfels, models. Output:
// tree, roots. Nodes take the numbers of positions, not of a counter, so that a build is repeatable.
// Floor: 36 B a surfel read, 68 B written and read again a node; 250 box unions a surfel.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_binary.glsl"
#include "bvh_merge.glsl"
RELIDAR_PARAMS(BvhClusterParams);

const uint KEPT = 16u, RADIUS = 8u;
struct Cluster {
    Box box;
    uint root;    // node or leaf
    uint spare;   // position of its subtree that numbers no node yet
};
Cluster clusters[2u * KEPT];
uint nearest[2u * KEPT];
float distances[2u * KEPT];
uint n_clusters;

int first, last;   // sorted positions of the model

/// Length of the common prefix of the keys at a position and the next; -1 at the ends of the model.
int common_prefix(int i) {
    if (i < first || i >= last) return -1;
    uvec2 a = params.keys.at[i], b = params.keys.at[i + 1];
    if (a.y != b.y) return 31 - findMSB(a.y ^ b.y);
    if (a.x != b.x) return 63 - findMSB(a.x ^ b.x);
    return 95 - findMSB(uint(i ^ (i + 1)));
}

/// Appends the clusters of a range.
void load_clusters(int from, int to) {
    SharedUints roots = SharedUints(uint64_t(params.clusters));
    for (int i = from; i <= min(to, from + int(KEPT) - 1); ++i) {
        uint root = roots.at[i];
        if (root == RELIDAR_BVH_NO_NODE) return;
        Cluster c;
        c.root = root;
        if (is_leaf(root)) {
            c.spare = root & ~RELIDAR_BVH_LEAF;
            c.box = load_box(params.boxes, params.surfels.at[c.spare]);
        } else {
            c.spare = SharedUints(uint64_t(params.tree.spares)).at[root];
            c.box = load_shared_box(params.tree.boxes, root);
        }
        clusters[n_clusters++] = c;
    }
}

void store_clusters(int from) {
    SharedUints roots = SharedUints(uint64_t(params.clusters));
    for (uint k = 0u; k < n_clusters; ++k) roots.at[from + k] = clusters[k].root;
    if (n_clusters < KEPT) roots.at[from + n_clusters] = RELIDAR_BVH_NO_NODE;
}

/// For each cluster the one of its neighbours with which it has the smallest box; of equal pairs the first, so that one pair is mutual.
void find_nearest() {
    for (uint i = 0u; i < n_clusters; ++i) distances[i] = BOX_HUGE;
    for (uint i = 0u; i < n_clusters; ++i)
        for (uint j = i + 1u; j < min(i + 1u + RADIUS, n_clusters); ++j) {
            float area = half_area(joined(clusters[i].box, clusters[j].box));
            if (area < distances[i]) {
                distances[i] = area;
                nearest[i] = j;
            }
            if (area < distances[j]) {
                distances[j] = area;
                nearest[j] = i;
            }
        }
}

/// A node above two clusters.
Cluster merged(Cluster a, Cluster b) {
    uint node = b.spare;
    Box box = joined(a.box, b.box);
    store_shared_box(params.tree.boxes, node, box);
    SharedUints(uint64_t(params.tree.spares)).at[node] = a.spare;
    params.tree.children.at[node] = uvec2(a.root, b.root);
    write_costs(params.tree, node, Subtree(a.root, half_area(a.box)), Subtree(b.root, half_area(b.box)), half_area(box));
    return Cluster(box, node, a.spare);
}

/// Merges until at most so many are left.
void reduce_to(uint wanted) {
    while (n_clusters > wanted) {
        find_nearest();
        uint n = 0u;
        for (uint i = 0u; i < n_clusters; ++i) {
            uint j = nearest[i];
            bool mutual = nearest[j] == i;
            if (mutual && j < i) continue;
            clusters[n] = clusters[i];
            if (mutual) clusters[n] = merged(clusters[i], clusters[j]);
            ++n;
        }
        n_clusters = n;
    }
}

void main() {
    uint position = thread_index();
    if (position >= params.n_surfels) return;
    uint model = find_model(params.models, params.n_models, position);
    first = int(params.models.at[model].x);
    last = first + int(params.models.at[model].y) - 1;
    int from = int(position), to = from;
    SharedUints(uint64_t(params.clusters)).at[position] = position | RELIDAR_BVH_LEAF;
    while (from != first || to != last) {
        int left = common_prefix(from - 1), right = common_prefix(to), split = left > right ? from - 1 : to;
        memoryBarrierBuffer();
        uint other = atomicExchange(SharedUints(uint64_t(params.other_ends)).at[split], uint(split == to ? from : to));
        memoryBarrierBuffer();
        if (other == RELIDAR_BVH_NO_NODE) return;   // the other range goes on when it arrives
        if (split == to) to = int(other);
        else from = int(other);
        if (to - from < int(KEPT)) continue;
        n_clusters = 0u;
        load_clusters(from, split);
        load_clusters(split + 1, to);
        if (n_clusters > KEPT) reduce_to(KEPT);
        store_clusters(from);
    }
    n_clusters = 0u;
    load_clusters(first, last);
    reduce_to(1u);
    params.roots.at[model] = clusters[0].root;
}
