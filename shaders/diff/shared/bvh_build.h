// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that build and refit the software acceleration structure
// (shaders/diff/accel/bvh_*.comp). They build one tree per model, all in the same arrays.
// First they build binary trees over surfels that are sorted along a space-filling curve.
// Then they convert these trees to wide nodes with up to eight child slots. Sizes stay on
// the device. No kernel waits for another workgroup of the same launch.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#include "relidar/diff/bvh.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

// Number of threads per workgroup of the kernels that use shared memory. This is at most
// 64 subgroups.
#define RELIDAR_BVH_WORKGROUP 256u
#define RELIDAR_BVH_TILE 4096u       // elements per workgroup of the kernels that use shared memory
#define RELIDAR_BVH_MORTON_BITS 13u  // bits per axis
// Flag of a binary node's child: the child is a leaf, and the other bits are its sorted
// position.
#define RELIDAR_BVH_LEAF 0x80000000u

RELIDAR_POINTER(Uvec2s, uvec2);

/// Parameters of accel/bvh_bounds.comp, which computes the bounds of each model. Surfels
/// that can never be hit are ignored.
struct BvhBoundsParams {
    // Input [n,6] in m: box of each surfel. A surfel that can never be hit has an empty
    // box.
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    Models models;  // input [n_models]
    // Accumulated [n_models,6]: minima of x, y, z, -x, -y, -z over the box centres.
    // Floats are stored as integers with the same order.
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

/// Binary trees over the sorted surfels. A child is a node index, or the sorted position
/// of a surfel with the flag LEAF. The index of each node is also a sorted position of
/// the same model.
struct BvhBinary {
    RELIDAR_OF(Uvec2s, BinaryChildren) children;  // [n]
    RELIDAR_OF(Floats, BinaryBoxes) boxes;        // [n,6] m
    // Cost [n,7] of storing a node's subtree as at most 1 ... 7 children of an eight-wide
    // node, m^2.
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // Best distribution of a wide node's child slots to the two children of a binary node
    // [n]. The lowest 4 bits contain the number of surfels in the subtree, at most 15.
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    // Sorted position [n] in a node's subtree that is not yet used as a node index.
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
    // Scratch [n]: for each split between neighbouring ranges, the far end of the range
    // that reached the split first. Initially NO_NODE.
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // Scratch [n]: root nodes of the clusters of a range. The list starts at the first
    // position of the range and ends with NO_NODE if space is left.
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
    // Number of inner children whose boxes are finished [bound]. Always 0 between
    // launches.
    RELIDAR_OF(Uints, Arrivals) arrivals;
    RELIDAR_OF(Uints, WideCount) count;  // [1] number of nodes in use
};

/// Parameters of the kernels accel/bvh_wide_*.comp, which convert binary trees to trees
/// of wide nodes.
struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // Queue [bound] of binary nodes that become wide nodes. The roots of the models come
    // first, then one level after another. The order within a level is arbitrary.
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // Children [bound,8] of the wide node that replaces each binary node in the queue.
    // Unused entries contain NO_NODE.
    RELIDAR_OF(Uints, WideSlots) slots;
    // Number of binary nodes in the queue per tree level [levels + 1], without the roots.
    // Initially 0.
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // For each binary node [n] that becomes a wide node: number of inner children + 256 *
    // number of leaf entries. 0 for all other nodes.
    RELIDAR_OF(Uints, SlotDemands) demands;
    // Number of inner children and number of leaf entries, summed over all earlier binary
    // nodes of the tile [n].
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
    BvhPointers bvh;                             // output: roots, count_top_nodes, top_order
    Instances instances;                         // input [n_instances]
    RELIDAR_OF(Uints, InstanceModels) model_of;  // input [n_instances]
    Models models;                               // input [n_models]
    // Input [n_models,6] in m, model frame: boxes of the models' root nodes, which are
    // the first wide nodes.
    RELIDAR_OF(Floats, WideBoxes) model_boxes;
    RELIDAR_OF(Floats, InstanceBoxes) boxes;  // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                              // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // Length of `keys`, a power of two.
};

/// Parameters of accel/bvh_cost.comp, which computes the cost of the trees with the
/// surface area heuristic.
struct BvhCostParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    RELIDAR_OF(Floats, CostSums) partial;   // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
