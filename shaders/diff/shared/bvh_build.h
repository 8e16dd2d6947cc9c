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

// Number of threads per workgroup of the kernels that use shared memory. A workgroup has
// at most 64 subgroups.
#define RELIDAR_BVH_WORKGROUP 256u
#define RELIDAR_BVH_TILE 4096u       // elements per workgroup of these kernels: 16 per thread
#define RELIDAR_BVH_MORTON_BITS 13u  // bits per axis
// Flag of a child of a binary node: the child is a leaf, given by its sorted position.
#define RELIDAR_BVH_LEAF 0x80000000u

RELIDAR_POINTER(Uvec2s, uvec2);

/// Parameters of the kernel that computes bounds of each model, over all surfels that can
/// be hit.
struct BvhBoundsParams {
    // Input [n,6] in m: boxes of the surfels. The box of a surfel that is never hit is
    // empty.
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    Models models;  // input [n_models]
    // Accumulated [n_models,6]: minimum of the box centres' x, y, z and of -x, -y, -z.
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
    RELIDAR_OF(Uints, OtherEnds) other_ends;  // output [n] NO_NODE, initial value for bvh_cluster
    RELIDAR_OF(Uints, SlotDemands) demands;   // output [n] 0, initial value for bvh_wide_mark
    uint n_surfels;
    uint n_models;
};

/// Binary trees over the sorted surfels. A child is either a node, or a sorted position
/// with the bit LEAF. The index of a node is also one of the sorted positions of its
/// model.
struct BvhBinary {
    RELIDAR_OF(Uvec2s, BinaryChildren) children;  // [n]
    RELIDAR_OF(Floats, BinaryBoxes) boxes;        // [n,6] m
    // [n,7]: cost of storing the subtree in at most 1 ... 7 slots of a wide node, m^2.
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // [n]: best distribution of the slots to both children. See accel/bvh_binary.glsl.
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    // [n]: sorted position in a node's subtree that is not yet the index of a node.
    RELIDAR_OF(Uints, SpareNodes) spares;
};

/// Parameters of accel/bvh_cluster.comp, which clusters the sorted surfels.
struct BvhClusterParams {
    BvhBinary tree;                            // output
    RELIDAR_OF(Floats, SurfelBoxes) boxes;     // input [n,6] boxes of the surfels
    RELIDAR_OF(Uvec2s, MortonKeys) keys;       // input [n] sorted
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    // [n]: other end of the range that first reached the split after a position.
    // Initially NO_NODE.
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // [n]: roots of the clusters of a range, stored from its first position on. NO_NODE
    // follows the last cluster if slots are left.
    RELIDAR_OF(Uints, BinaryClusters) clusters;
    RELIDAR_OF(Uints, BinaryRoots) roots;  // output [n_models] root of each model
    uint n_surfels;
    uint n_models;
};

/// Wide nodes, and the data that only the build and the refit need.
struct BvhWide {
    BvhNodes nodes;                       // [bound]
    RELIDAR_OF(Uints, LeafOrder) order;   // [n]
    RELIDAR_OF(Uvec2s, WideLinks) links;  // [bound] parent or NO_NODE, first surfel of the model
    RELIDAR_OF(Floats, WideBoxes) boxes;  // [bound,6] m: box of the node before quantisation
    // [bound]: number of inner children whose boxes are finished. 0 between launches.
    RELIDAR_OF(Uints, Arrivals) arrivals;
    RELIDAR_OF(Uints, WideCount) count;  // [1] number of nodes in use
};

/// Parameters of the kernels accel/bvh_wide_*.comp, which convert binary trees to trees
/// of wide nodes.
struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // [bound]: binary nodes that become wide nodes. The roots of the models are first,
    // then level by level. The order within a level is arbitrary.
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // [bound,8]: children of the wide node of each queue entry. Unused slots hold
    // NO_NODE.
    RELIDAR_OF(Uints, WideSlots) slots;
    // [levels + 1]: number of queue entries per level, without the roots. Initially 0.
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // [n]: wide children + 256 * leaf entries of each binary node. 0 if the node does not
    // become a wide node.
    RELIDAR_OF(Uints, SlotDemands) demands;
    // [n]: number of inner children and of leaf entries of all earlier nodes of the tile.
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

/// Parameters of the kernel that builds the tree over all instances.
struct BvhTopParams {
    BvhPointers bvh;                             // output: roots, top_nodes, top_order
    Instances instances;                         // input [n_instances]
    RELIDAR_OF(Uints, InstanceModels) model_of;  // input [n_instances]
    Models models;                               // input [n_models]
    // Input [n_models,6] in m, model frame: boxes of the root nodes. The roots are the
    // first wide nodes.
    RELIDAR_OF(Floats, WideBoxes) model_boxes;
    RELIDAR_OF(Floats, InstanceBoxes) boxes;  // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                              // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // Length of `keys`, a power of two.
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
