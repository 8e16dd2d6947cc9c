// SPDX-License-Identifier: Apache-2.0
// Binary radix trees over the sorted keys of each model (Karras, "Maximizing Parallelism in the Construction of BVHs, Octrees, and k-d
// Trees", 2012): node i finds its range and its split from the keys alone; equal keys are told apart by position. One thread a sorted
// position. Input: keys, models. Output: tree but its boxes. Floor: 8 B read, 32 B written a surfel; the searches hit caches.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/bvh_build.h"
#include "bvh_forest.glsl"
#include "bvh_binary.glsl"
RELIDAR_PARAMS(BvhHierarchyParams);

int first, last;   // sorted positions of the model

/// Length of the common prefix of two positions; -1 outside the model.
int common_prefix(int i, int j) {
    if (j < first || j > last) return -1;
    uvec2 a = params.keys.at[i], b = params.keys.at[j];
    if (a.y != b.y) return 31 - findMSB(a.y ^ b.y);
    if (a.x != b.x) return 63 - findMSB(a.x ^ b.x);
    return 95 - findMSB(uint(i ^ j));
}

/// The other end of node i's range, in direction d.
int range_end(int i, int d) {
    int outside = common_prefix(i, i - d), step = 2;
    while (common_prefix(i, i + step * d) > outside) step *= 2;
    int length = 0;
    for (int t = step / 2; t > 0; t /= 2)
        if (common_prefix(i, i + (length + t) * d) > outside) length += t;
    return i + length * d;
}

/// Last position of the left half of node i's range.
int split_of(int i, int j, int d) {
    int prefix = common_prefix(i, j), length = abs(j - i), split = 0;
    for (int t = (length + 1) / 2;; t = (t + 1) / 2) {
        if (split + t < length + 1 && common_prefix(i, i + (split + t) * d) > prefix) split += t;
        if (t == 1) break;
    }
    return i + split * d + min(d, 0);
}

void main() {
    uint thread = thread_index();
    if (thread >= params.n_surfels) return;
    uint model = find_model(params.models, params.n_models, thread);
    uvec2 range = params.models.at[model];
    first = int(range.x);
    last = int(range.x + range.y) - 1;
    int i = int(thread);
    params.tree.arrivals.at[i] = 0u;
    params.tree.states.at[i] = 0u;
    if (i == first) {
        params.tree.parents.at[i] = RELIDAR_BVH_NO_NODE;
        params.tree.places.at[i] = model;
    }
    if (i == last) {   // a model of n surfels has n - 1 nodes; of one surfel, a root with one child
        bool alone = first == last;
        params.tree.children.at[i] = uvec2(alone ? thread | RELIDAR_BVH_LEAF : RELIDAR_BVH_NO_NODE, RELIDAR_BVH_NO_NODE);
        params.tree.parents.at[i] = RELIDAR_BVH_NO_NODE;
        if (!alone) return;
        params.tree.leaf_parents.at[i] = RELIDAR_BVH_NO_NODE;
        params.tree.states.at[i] = make_state(1u, 1u);
        return;
    }
    int d = common_prefix(i, i + 1) > common_prefix(i, i - 1) ? 1 : -1;
    int j = range_end(i, d), split = split_of(i, j, d);
    bool left_leaf = min(i, j) == split, right_leaf = max(i, j) == split + 1;
    uint left = uint(split), right = uint(split + 1);
    params.tree.children.at[i] = uvec2(left_leaf ? left | RELIDAR_BVH_LEAF : left, right_leaf ? right | RELIDAR_BVH_LEAF : right);
    if (left_leaf) params.tree.leaf_parents.at[left] = thread;
    else params.tree.parents.at[left] = thread;
    if (right_leaf) params.tree.leaf_parents.at[right] = thread;
    else params.tree.parents.at[right] = thread;
}
