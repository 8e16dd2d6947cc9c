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

RELIDAR_DECLARE_POINTER(Uvec2s, uvec2);

struct BvhBoundsParams {
    // Input [n,6] in m: box of each surfel, empty for a surfel that no ray can hit.
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    Models models;  // input [n_models]
    // Bounds of the centres of the surfel boxes of each model, [n_models,6]: min x, min
    // y, min z, -max x, -max y, -max z. Floats are stored as integers with the same
    // order, because atomicMin() needs integers.
    RELIDAR_OF(Uints, ModelBounds) bounds;
    uint n_surfels;
    uint n_models;
};

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
    // Traversal costs [n,7] of each node's subtree, as weighted box areas in m^2. A
    // subtree may use several of the eight child slots of a wide node. Entry k - 1 is the
    // lowest cost with at most k slots.
    RELIDAR_OF(Floats, BinaryCosts) costs;
    // One word per node [n], see bvh_binary.glsl: the number of surfels below the node,
    // and how many of k child slots of a wide node its left child gets, for k = 2 to 8.
    RELIDAR_OF(Uints, BinaryDecisions) decisions;
    // The index of a node is the sorted position of a surfel below it. A subtree with k
    // surfels has k - 1 nodes, so one of its k positions stays unused. For each node [n]:
    // this position, which a later parent node uses as its index.
    RELIDAR_OF(Uints, SpareNodes) spares;
};

struct BvhClusterParams {
    BvhBinary tree;                            // output
    RELIDAR_OF(Floats, SurfelBoxes) boxes;     // input [n,6] boxes of the surfels
    RELIDAR_OF(Uvec2s, MortonKeys) keys;       // input [n] sorted
    RELIDAR_OF(Uints, SortedSurfels) surfels;  // input [n] surfel at each sorted position
    Models models;                             // input [n_models]
    // Scratch [n], initially RELIDAR_BVH_NO_NODE. Two threads use entry i to join their
    // ranges of sorted surfels, a ... i and i + 1 ... b. The first thread stores the far
    // end of its range (a or b). The second one reads it and continues with a ... b.
    RELIDAR_OF(Uints, OtherEnds) other_ends;
    // Scratch [n]: roots of the subtrees that contain a range a ... b of sorted surfels.
    // They are stored in entries a, a + 1 and so on. RELIDAR_BVH_NO_NODE marks the end if
    // joining ranges has left fewer than 16 roots.
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
    // [bound] number of child nodes whose boxes are up to date; 0 between launches
    RELIDAR_OF(Uints, Arrivals) arrivals;
    RELIDAR_OF(Uints, WideCount) count;  // [1] number of nodes in use
};

struct BvhWideParams {
    BvhBinary tree;  // input
    BvhWide wide;    // output
    // Binary nodes that are converted to wide nodes (up to eight children), sorted by
    // tree level, roots first. Has `bound` entries, the maximum number of wide nodes.
    RELIDAR_OF(Uints, BinaryRoots) queue;
    // Children of each wide node, [bound,8]. Row i belongs to the wide node that replaces
    // binary node queue[i]. Unused entries are RELIDAR_BVH_NO_NODE.
    RELIDAR_OF(Uints, WideSlots) slots;
    // Number of nodes in `queue` on each level of the trees, [levels + 1], initially 0.
    // The entry of level 0 stays 0, because the number of roots is always n_models.
    RELIDAR_OF(Uints, LevelSizes) level_sizes;
    // Space that each binary node [n] needs as a wide node: c + 256 s, for c children
    // that are wide nodes and s surfels in its leaves. 0 if it is not converted.
    RELIDAR_OF(Uints, SlotDemands) demands;
    // The binary nodes are divided into tiles of RELIDAR_BVH_TILE nodes. For each node
    // [n]: sum of c and sum of s (see `demands`) over all earlier nodes of the same tile.
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

struct BvhTopParams {
    BvhPointers bvh;                           // output: roots, top_nodes, top_order
    Instances instances;                       // input [n_instances]
    RELIDAR_OF(Uints, ModelRoots) root_of;     // input [n_instances] root node of its model's tree
    RELIDAR_OF(Floats, WideBoxes) node_boxes;  // input [nodes,6] m, model frame
    RELIDAR_OF(Floats, InstanceBoxes) boxes;   // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;                               // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;  // Length of `keys`, a power of two.
};

struct BvhCostParams {
    BvhWide wide;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // input [n,6] boxes of the surfels
    RELIDAR_OF(Floats, CostSums) sums;      // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
