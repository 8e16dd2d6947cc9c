// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that build and refit the software acceleration structure
// (shaders/diff/accel/bvh_*.comp). The kernels build one forest for all models: first
// binary trees over surfels sorted along a space-filling curve, then wide nodes. Sizes
// are stored on the device. No kernel waits for another workgroup of the same launch.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BVH_BUILD_H
#include "relidar/diff/bvh.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_BVH_WORKGROUP 256u    // threads of the kernels that use shared memory; at most 64 subgroups
#define RELIDAR_BVH_TILE 4096u        // elements per workgroup of these kernels: 16 per thread
#define RELIDAR_BVH_MORTON_BITS 13u   // bits per axis
#define RELIDAR_BVH_LEAF 0x80000000u  // flag: the child of a binary node is a sorted position

RELIDAR_POINTER(Uvec2s, uvec2);

/// Parameters of accel/bvh_bounds.comp, which computes the bounds of the surfels of each
/// model that can be hit.
struct BvhBoundsParams {
    // input [n,6] m: surfel boxes, empty for surfels that are never hit
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    Models models;  // input [n_models]
    // Accumulated [n_models,6]: minimum ordered bits of the centres' x, y, z, then of -x,
    // -y, -z.
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
    RELIDAR_OF(Uints, OtherEnds) other_ends;  // output [n] NO_NODE, initial value for bvh_cluster
    RELIDAR_OF(Uints, SlotDemands) demands;   // output [n] 0, initial value for bvh_wide_mark
    uint n_surfels;
    uint n_models;
};

/// Binary trees over the sorted surfels. A child is a node, or a sorted position with the
/// bit LEAF. The number of a node is one of the sorted positions of its model.
struct BvhBinary {
    RELIDAR_OF(Uvec2s, BinaryChildren) children;  // [n]
    RELIDAR_OF(Floats, BinaryBoxes) boxes;        // [n,6] m
    // [n,7] Cost of the subtree in at most 1 ... 7 slots of a wide node, m^2.
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // [n] Distribution of these slots to the children; see accel/bvh_binary.glsl.
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    // [n] sorted position in a node's subtree that does not number a node yet
    RELIDAR_OF(Uints, SpareNodes) spares;
};

/// Parameters of accel/bvh_cluster.comp, which clusters the sorted surfels.
struct BvhClusterParams {
    BvhBinary tree;                            // output
    RELIDAR_OF(Floats, SurfelBoxes) boxes;     // input [n,6] boxes of the surfels
    RELIDAR_OF(Uvec2s, MortonKeys) keys;       // input [n] sorted
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    // [n] Initially NO_NODE: other end of the range that first arrived at the split after
    // a position.
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // [n] Roots of the clusters of a range, from its first position on. Ends with NO_NODE
    // if there are fewer clusters than slots.
    RELIDAR_OF(Uints, BinaryClusters) clusters;
    RELIDAR_OF(Uints, BinaryRoots) roots;  // output [n_models] root of each model
    uint n_surfels;
    uint n_models;
};

/// Wide nodes and the data that only building and refitting need.
struct BvhWide {
    BvhNodes nodes;                       // [bound]
    RELIDAR_OF(Uints, LeafOrder) order;   // [n]
    RELIDAR_OF(Uvec2s, WideLinks) links;  // [bound] parent or NO_NODE, first surfel of the model
    RELIDAR_OF(Floats, WideBoxes) boxes;  // [bound,6] m: box of the node before quantisation
    // [bound] number of inner children that are finished; 0 between launches
    RELIDAR_OF(Uints, Arrivals) arrivals;
    RELIDAR_OF(Uints, WideCount) count;  // [1] number of nodes in use
};

/// Parameters of the kernels accel/bvh_wide_*.comp, which collapse binary trees into wide
/// nodes.
struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // [bound] Binary nodes that become wide nodes: first the roots of the models, then
    // level by level. The order within a level is arbitrary.
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // [bound,8] Children of the wide node of a queue entry. Unused slots are NO_NODE.
    RELIDAR_OF(Uints, WideSlots) slots;
    // [levels + 1] Number of queue entries of each level. Initially 0; the roots are not
    // counted.
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // [n] Per binary node: wide children + 256 * leaf entries. 0 if the node does not
    // become wide.
    RELIDAR_OF(Uints, SlotDemands) demands;
    // [n] Sums of the inner children and leaf entries of the preceding nodes of the tile.
    RELIDAR_OF(Uvec2s, TileOffsets) offsets;
    RELIDAR_OF(Uvec2s, SumsOfTiles) tiles;     // [n_tiles] the same sums over the preceding tiles
    RELIDAR_OF(Uints, WidePlaces) places;      // [n] wide node that replaces a binary node
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    uint n_surfels;
    uint n_tiles;
    uint n_models;
    uint bound;  // capacity in wide nodes
    uint level;  // level that a launch of bvh_wide_mark processes
};

struct BvhRefitParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    uint bound;                             // capacity in wide nodes
    uint first_surfel;                      // Models whose first surfel is in [first_surfel,
    uint last_surfel;                       // last_surfel] are refitted.
};

/// Parameters of accel/bvh_top.comp, which builds the tree over the instances.
struct BvhTopParams {
    BvhPointers bvh;                             // output: roots, top_nodes, top_order
    Instances instances;                         // input [n_instances]
    RELIDAR_OF(Uints, InstanceModels) model_of;  // input [n_instances]
    Models models;                               // input [n_models]
    // Input [n_models,6] m, model frame: boxes of the first wide nodes, which are the
    // roots.
    RELIDAR_OF(Floats, WideBoxes) model_boxes;
    RELIDAR_OF(Floats, InstanceBoxes) boxes;  // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                              // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // the power of two that is the length of `keys`
};

/// Parameters of accel/bvh_cost.comp, which computes the surface-area cost.
struct BvhCostParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    RELIDAR_OF(Floats, CostSums) partial;   // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
