// SPDX-License-Identifier: Apache-2.0
// Computes the cost of converting a binary subtree to wide nodes, which have up to eight
// child slots (Ylitie et al. 2017, Eq. 2-5). The cost depends on the surface areas of the
// boxes that a ray tests.
#ifndef RELIDAR_INCLUDED_DIFF_ACCEL_BVH_MERGE_GLSL
#define RELIDAR_INCLUDED_DIFF_ACCEL_BVH_MERGE_GLSL

struct Subtree {
    uint root;
    float area;
};

/// Loads the traversal costs of a subtree below a wide node, which has eight child slots.
/// costs[k] is the cost if the subtree gets at most k of these slots.
void load_costs(BvhBinary tree, Subtree subtree, out float costs[RELIDAR_BVH_WIDTH]) {
    for (uint k = 1u; k < RELIDAR_BVH_WIDTH; ++k)
        costs[k] = is_leaf(subtree.root) ? subtree.area * SURFEL_COST
                                         : SharedFloats(uvec2(tree.costs)).at[7u * subtree.root + k - 1u];
}

/// Stores the lowest traversal cost of a binary subtree for each number k of child slots
/// that it may use in a wide node. The two children of the binary node divide the k
/// slots. Also stores, for each k, how many slots the left child gets.
void write_costs(BvhBinary tree, uint node, Subtree left, Subtree right, float area) {
    float in_left[RELIDAR_BVH_WIDTH], in_right[RELIDAR_BVH_WIDTH];
    load_costs(tree, left, in_left);
    load_costs(tree, right, in_right);
    SharedUints decided = SharedUints(uvec2(tree.decisions));
    uint n_left = is_leaf(left.root) ? 1u : unpack_surfels(decided.at[left.root]),
         n_right = is_leaf(right.root) ? 1u : unpack_surfels(decided.at[right.root]);
    uint n_surfels = min(n_left + n_right, 15u), decisions = n_surfels;
    float all = BOX_HUGE;
    uint share_of_all = 1u;
    for (uint k = 1u; k < RELIDAR_BVH_WIDTH; ++k) {
        float cost = in_left[k] + in_right[RELIDAR_BVH_WIDTH - k];
        if (cost < all) {
            all = cost;
            share_of_all = k;
        }
    }
    decisions |= share_of_all << (3u * RELIDAR_BVH_WIDTH - 2u);
    float best = n_surfels <= RELIDAR_BVH_LEAF_SIZE ? area * SURFEL_COST * float(n_surfels) : area + all;
    SharedFloats costs = SharedFloats(uvec2(tree.costs));
    costs.at[7u * node] = best;
    for (uint n = 2u; n < RELIDAR_BVH_WIDTH; ++n) {
        uint share = 0u;
        for (uint k = 1u; k < n; ++k) {
            float cost = in_left[k] + in_right[n - k];
            if (cost <= best) {
                best = cost;
                share = k;
            }
        }
        decisions |= share << (3u * n - 2u);
        costs.at[7u * node + n - 1u] = best;
    }
    decided.at[node] = decisions;
}
#endif
