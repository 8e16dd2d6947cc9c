// SPDX-License-Identifier: Apache-2.0
// What the kernels that build and refit the software acceleration structure
// (shaders/diff/accel/bvh_*.comp) read and write. One forest for all models: binary trees
// over surfels sorted along a space-filling curve, then wide nodes. Sizes live on the
// device; no kernel waits for another workgroup of its own launch.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#include "relidar/diff/bvh.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_BVH_WORKGROUP 256u    // threads of the kernels that share memory; 64 subgroups at most
#define RELIDAR_BVH_TILE 4096u        // elements of one workgroup of these kernels: 16 a thread
#define RELIDAR_BVH_MORTON_BITS 13u   // an axis
#define RELIDAR_BVH_LEAF 0x80000000u  // a child of a binary node is a sorted position

RELIDAR_POINTER(Uvec2s, uvec2);

/// Bounds of the means of each model that can be hit (accel/bvh_bounds.comp).
struct BvhBoundsParams {
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] m: surfel boxes, empty where never hit
    Models models;                          // input [n_models]
    // accumulated [n_models,6]: least ordered bits of the centres' x, y, z, then of -x,
    // -y, -z
    RELIDAR_OF(Uints, ModelBounds) bounds;
    uint n_surfels;
    uint n_models;
};

/// Sort keys (accel/bvh_keys.comp).
struct BvhKeysParams {
    Records records;                          // input [n]
    Models models;                            // input [n_models]
    RELIDAR_OF(Uints, ModelBounds) bounds;    // input [n_models,6]
    RELIDAR_OF(Uvec2s, MortonKeys) keys;      // output [n] low, high: Morton code, then model
    RELIDAR_OF(Uints, OtherEnds) other_ends;  // output [n] NO_NODE, for bvh_cluster
    RELIDAR_OF(Uints, SlotDemands) demands;   // output [n] 0, for bvh_wide_mark
    uint n_surfels;
    uint n_models;
};

/// Binary trees over the sorted surfels. A child is a node, or a sorted position with the
/// bit LEAF. A node of a model has the number of one of the sorted positions of its
/// surfels.
struct BvhBinary {
    RELIDAR_OF(Uvec2s, BinaryChildren) children;  // [n]
    RELIDAR_OF(Floats, BinaryBoxes) boxes;        // [n,6] m
    // [n,7] of the subtree in at most 1 ... 7 slots of a wide node, m^2
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // [n] how these slots are shared out: see accel/bvh_binary.glsl
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    RELIDAR_OF(Uints, SpareNodes) spares;  // [n] the position of a node's subtree that numbers no node yet
};

/// Agglomeration along the sorted surfels (accel/bvh_cluster.comp).
struct BvhClusterParams {
    BvhBinary tree;                            // output
    RELIDAR_OF(Floats, SurfelBoxes) boxes;     // input [n,6] of surfels
    RELIDAR_OF(Uvec2s, MortonKeys) keys;       // input [n] sorted
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at a sorted position
    Models models;                             // input [n_models]
    // [n] NO_NODE before: other end of the range that first arrived at the split behind a
    // position
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // [n] roots within a range, from its first position on; fewer than there is room for
    // end with NO_NODE
    RELIDAR_OF(Uints, BinaryClusters) clusters;
    RELIDAR_OF(Uints, BinaryRoots) roots;  // output [n_models] root of each model
    uint n_surfels;
    uint n_models;
};

/// Wide nodes as they are built and refitted: what a traversal does not need.
struct BvhWide {
    BvhNodes nodes;                        // [bound]
    RELIDAR_OF(Uints, LeafOrder) order;    // [n]
    RELIDAR_OF(Uvec2s, WideLinks) links;   // [bound] parent or NO_NODE, first surfel of the model
    RELIDAR_OF(Floats, WideBoxes) boxes;   // [bound,6] m: real box of the node
    RELIDAR_OF(Uints, Arrivals) arrivals;  // [bound] inner children that are done; 0 between launches
    RELIDAR_OF(Uints, WideCount) count;    // [1] nodes in use
};

/// Collapse of binary trees into wide nodes (accel/bvh_wide_*.comp).
struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // [bound] binary nodes that become wide: first the roots of the models, then level by
    // level, in any order
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // [bound,8] children of the wide node made of a queue entry, NO_NODE behind the last
    RELIDAR_OF(Uints, WideSlots) slots;
    // [levels + 1] queue entries of each level; 0 before, the roots are known
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // [n] of a binary node: wide children + 256 leaf entries; 0 where it does not become
    // wide
    RELIDAR_OF(Uints, SlotDemands) demands;
    // [n] inner children, leaf entries of the nodes before in the tile
    RELIDAR_OF(Uvec2s, TileOffsets) offsets;
    RELIDAR_OF(Uvec2s, SumsOfTiles) tiles;     // [n_tiles] the same of the tiles before
    RELIDAR_OF(Uints, WidePlaces) places;      // [n] wide node made of a binary node
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at a sorted position
    Models models;                             // input [n_models]
    uint n_surfels;
    uint n_tiles;
    uint n_models;
    uint bound;  // wide nodes there is room for
    uint level;  // of a launch of bvh_wide_mark
};

struct BvhRefitParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] of surfels
    uint bound;                             // wide nodes there is room for
    uint first_surfel;                      // models that begin from here
    uint last_surfel;                       // to here are refitted
};

/// The tree over the instances (accel/bvh_top.comp).
struct BvhTopParams {
    BvhPointers bvh;                             // output: roots, top_nodes, top_order
    Instances instances;                         // input [n_instances]
    RELIDAR_OF(Uints, InstanceModels) model_of;  // input [n_instances]
    Models models;                               // input [n_models]
    // input [n_models,6] m, model frame: boxes of the first wide nodes, which are the
    // roots
    RELIDAR_OF(Floats, WideBoxes) model_boxes;
    RELIDAR_OF(Floats, InstanceBoxes) boxes;  // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                              // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // that power of two
};

/// Surface-area cost (accel/bvh_cost.comp).
struct BvhCostParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] of surfels
    RELIDAR_OF(Floats, CostSums) partial;   // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
