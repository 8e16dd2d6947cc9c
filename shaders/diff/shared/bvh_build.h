// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that build and refit the software acceleration structure
// (shaders/diff/accel/bvh_*.comp). They build one tree per model, all in the same arrays.
// First they build binary trees over surfels that are sorted along a space-filling curve.
// Then they convert these trees to wide nodes with up to eight child slots. The host does
// not read sizes. No kernel waits for another workgroup of the same launch.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#include "relidar/diff/bvh.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

// Number of threads per workgroup of the kernels that use shared memory. Their arrays in
// shared memory have room for at most 64 subgroups.
#define RELIDAR_BVH_WORKGROUP 256u
#define RELIDAR_BVH_TILE 4096u       // elements per workgroup of the kernels that use shared memory
#define RELIDAR_BVH_MORTON_BITS 13u  // bits per axis
// Flag in a child of a binary node: the child is a surfel, and the other bits are its
// position in the sorted list.
#define RELIDAR_BVH_LEAF 0x80000000u

RELIDAR_POINTER(Uvec2s, uvec2);

/// Parameters of accel/bvh_bounds.comp, which computes the bounds of each model. Surfels
/// that no ray can hit are ignored.
struct BvhBoundsParams {
    // Input [n,6] in m: box of each surfel. A surfel that can never be hit has an empty
    // box.
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    Models models;  // input [n_models]
    // Bounds [n_models,6] of the box centres of each model's surfels: minima and negative
    // maxima of x, y, z. Floats are mapped to integers in the same order for atomicMin().
    RELIDAR_OF(Uints, ModelBounds) bounds;
    uint n_surfels;
    uint n_models;
};

/// Parameters of accel/bvh_keys.comp, which computes the sort keys.
struct BvhKeysParams {
    Records records;                          // input [n]
    Models models;                            // input [n_models]
    RELIDAR_OF(Uints, ModelBounds) bounds;    // input [n_models,6]
    RELIDAR_OF(Uvec2s, MortonKeys) keys;      // output [n] low, high word: Morton code, then model
    RELIDAR_OF(Uints, OtherEnds) other_ends;  // output [n]: initial value NO_NODE for bvh_cluster
    RELIDAR_OF(Uints, SlotDemands) demands;   // output [n]: initial value 0 for bvh_wide_mark
    uint n_surfels;
    uint n_models;
};

/// Binary trees over the sorted surfels. A child is either the index of a node, or the
/// position of a surfel with the flag RELIDAR_BVH_LEAF.
struct BvhBinary {
    RELIDAR_OF(Uvec2s, BinaryChildren) children;  // [n]
    RELIDAR_OF(Floats, BinaryBoxes) boxes;        // [n,6] m
    // Traversal costs [n,7] of each node's subtree: weighted box areas, m^2. Entry k - 1
    // is the cost if the subtree gets at most k of the eight child slots of a wide node.
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // One word per node [n]: number of surfels below the node, and how its two children
    // divide the child slots of a wide node. See bvh_binary.glsl.
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    // For each node [n]: a free index for a later parent node. A node is numbered by the
    // position of a surfel below it. k surfels have k positions but only k - 1 nodes
    // above them, so that one position is always free.
    RELIDAR_OF(Uints, SpareNodes) spares;
};

/// Parameters of accel/bvh_cluster.comp, which builds binary trees over the sorted
/// surfels by clustering.
struct BvhClusterParams {
    BvhBinary tree;                            // output
    RELIDAR_OF(Floats, SurfelBoxes) boxes;     // input [n,6] boxes of the surfels
    RELIDAR_OF(Uvec2s, MortonKeys) keys;       // input [n] sorted
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    // Scratch [n]: entry i is for two ranges of sorted surfels that meet between surfels
    // i and i + 1. The first of their two threads stores the outer end of its range. The
    // other one reads it and joins the ranges. Initially RELIDAR_BVH_NO_NODE.
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // Scratch [n]: for each range of sorted surfels, a list of the roots of its subtrees.
    // It starts at the index of the first surfel, and ends with RELIDAR_BVH_NO_NODE.
    RELIDAR_OF(Uints, BinaryClusters) clusters;
    RELIDAR_OF(Uints, BinaryRoots) roots;  // output [n_models] root of each model
    uint n_surfels;
    uint n_models;
};

/// Trees of wide nodes (up to eight children). Some members are used only to build and
/// refit the trees.
struct BvhWide {
    BvhNodes nodes;                       // [bound]
    RELIDAR_OF(Uints, LeafOrder) order;   // [n]
    RELIDAR_OF(Uvec2s, WideLinks) links;  // [bound] parent or NO_NODE, first surfel of the model
    RELIDAR_OF(Floats, WideBoxes) boxes;  // [bound,6] m: box of the node before quantisation
    // For each of `bound` nodes: number of its child nodes whose boxes are up to date.
    // Always 0 between launches.
    RELIDAR_OF(Uints, Arrivals) arrivals;
    RELIDAR_OF(Uints, WideCount) count;  // [1] number of nodes in use
};

/// Parameters of the kernels accel/bvh_wide_*.comp, which convert binary trees to trees
/// of wide nodes.
struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // Binary nodes [bound] that are converted to wide nodes (up to eight children),
    // sorted by tree level. The first entries are the roots.
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // Children of each wide node, [bound,8]. Row i belongs to the wide node that replaces
    // binary node queue[i]. Unused entries are RELIDAR_BVH_NO_NODE. `bound` is the
    // maximum number of wide nodes.
    RELIDAR_OF(Uints, WideSlots) slots;
    // Entry k: number of nodes in `queue` on level k of the tree, [levels + 1]. Entry 0
    // stays 0, because the roots are not counted. All entries are initially 0.
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // For each binary node [n] that becomes a wide node: number of the wide node's child
    // nodes + 256 * number of surfels in its leaves. 0 for all other binary nodes.
    RELIDAR_OF(Uints, SlotDemands) demands;
    // For each binary node [n]: sums of child nodes and of surfels in leaves (see
    // `demands`) over all earlier nodes of its tile. A tile has RELIDAR_BVH_TILE nodes.
    RELIDAR_OF(Uvec2s, TileOffsets) offsets;
    RELIDAR_OF(Uvec2s, SumsOfTiles) tiles;     // [n_tiles] the same sums over all earlier tiles
    RELIDAR_OF(Uints, WidePlaces) places;      // [n] wide node that replaces a binary node
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    uint n_surfels;
    uint n_tiles;
    uint n_models;
    uint bound;  // maximum number of wide nodes
    uint level;  // level that a launch of bvh_wide_mark processes
};

struct BvhRefitParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    uint bound;                             // maximum number of wide nodes
    uint first_surfel;                      // Refits models whose first surfel has at least this index.
    uint last_surfel;                       // Refits models whose first surfel has at most this index.
};

/// Parameters of accel/bvh_top.comp, which builds the top-level tree over all instances.
struct BvhTopParams {
    BvhPointers bvh;                             // output: roots, top_nodes, top_order
    Instances instances;                         // input [n_instances]
    RELIDAR_OF(Uints, InstanceModels) model_of;  // input [n_instances]
    Models models;                               // input [n_models]
    // Input [n_models,6]: bounding boxes of the models in the model frame, m.
    RELIDAR_OF(Floats, WideBoxes) model_boxes;
    RELIDAR_OF(Floats, InstanceBoxes) boxes;  // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                              // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // Length of `keys`, a power of two.
};

/// Parameters of accel/bvh_cost.comp, which estimates the traversal cost of the trees
/// with the surface area heuristic.
struct BvhCostParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    RELIDAR_OF(Floats, CostSums) partial;   // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
