// SPDX-License-Identifier: Apache-2.0
// What the kernels that build and refit the software acceleration structure (shaders/accel/bvh_*.comp) read and write. One forest for all
// models: binary trees over surfels sorted along a space-filling curve, then wide nodes. Sizes live on the device; no kernel waits
// for another workgroup of its own launch.
#ifndef RELIDAR_INCLUDED_SHARED_BVH_BUILD_H
#define RELIDAR_INCLUDED_SHARED_BVH_BUILD_H
#include "relidar/shared/bvh.h"
#include "scene.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_BVH_WORKGROUP 256u    // threads of the kernels that share memory; 32 subgroups at most
#define RELIDAR_BVH_TILE 4096u        // elements of one workgroup of these kernels: 16 a thread
#define RELIDAR_BVH_MORTON_BITS 13u   // an axis
#define RELIDAR_BVH_LEAF 0x80000000u  // a child of a binary node is a sorted position

RELIDAR_POINTER(Uvec2s, uvec2);

/// Bounds of the means of each model that can be hit (accel/bvh_bounds.comp).
struct BvhBoundsParams {
    Floats boxes;       // input [n,6] m: surfel boxes, empty where never hit
    Models models;      // input [n_models]
    Uints bounds;       // accumulated [n_models,6]: least ordered bits of the centres' x, y, z, then of -x, -y, -z
    uint n_surfels;
    uint n_models;
};

/// Sort keys (accel/bvh_keys.comp).
struct BvhKeysParams {
    Records records;    // input [n]
    Models models;      // input [n_models]
    Uints bounds;       // input [n_models,6]
    Uvec2s keys;        // output [n] low, high: Morton code, then model
    Uints other_ends;   // output [n] NO_NODE, for bvh_cluster
    Uints demands;      // output [n] 0, for bvh_wide_mark
    uint n_surfels;
    uint n_models;
};

/// Binary trees over the sorted surfels. A child is a node, or a sorted position with the bit LEAF. A node of a model has the number of one
/// of the sorted positions of its surfels.
struct BvhBinary {
    Uvec2s children;      // [n]
    Floats boxes;         // [n,6] m
    Floats costs;         // [n,7] of the subtree in at most 1 ... 7 slots of a wide node, m^2
    Uints decisions;      // [n] how these slots are shared out: see accel/bvh_binary.glsl
    Uints spares;         // [n] the position of a node's subtree that numbers no node yet
};

/// Agglomeration along the sorted surfels (accel/bvh_cluster.comp).
struct BvhClusterParams {
    BvhBinary tree;      // output
    Floats boxes;        // input [n,6] of surfels
    Uvec2s keys;         // input [n] sorted
    Uints surfels;       // input [n] surfel at a sorted position
    Models models;       // input [n_models]
    Uints other_ends;    // [n] NO_NODE before: other end of the range that first arrived at the split behind a position
    Uints clusters;      // [n] roots within a range, from its first position on; fewer than there is room for end with NO_NODE
    Uints roots;         // output [n_models] root of each model
    uint n_surfels;
    uint n_models;
};

/// Wide nodes as they are built and refitted: what a traversal does not need.
struct BvhWide {
    BvhNodes nodes;     // [bound]
    Uints order;        // [n]
    Uvec2s links;       // [bound] parent or NO_NODE, first surfel of the model
    Floats boxes;       // [bound,6] m: real box of the node
    Uints arrivals;     // [bound] inner children that are done; 0 between launches
    Uints count;        // [1] nodes in use
};

/// Collapse of binary trees into wide nodes (accel/bvh_wide_*.comp).
struct BvhWideParams {
    BvhBinary tree;     // input
    BvhWide wide;       // output
    Uints queue;        // [bound] binary nodes that become wide: first the roots of the models, then level by level, in any order
    Uints slots;        // [bound,8] children of the wide node made of a queue entry, NO_NODE behind the last
    Uints level_sizes;  // [levels + 1] queue entries of each level; 0 before, the roots are known
    Uints demands;      // [n] of a binary node: wide children + 256 leaf entries; 0 where it does not become wide
    Uvec2s offsets;     // [n] inner children, leaf entries of the nodes before in the tile
    Uvec2s tiles;       // [n_tiles] the same of the tiles before
    Uints places;       // [n] wide node made of a binary node
    Uints surfels;      // input [n] surfel at a sorted position
    Models models;      // input [n_models]
    uint n_surfels;
    uint n_tiles;
    uint n_models;
    uint bound;         // wide nodes there is room for
    uint level;         // of a launch of bvh_wide_mark
};

struct BvhRefitParams {
    BvhWide wide;
    Floats boxes;        // input [n,6] of surfels
    uint bound;          // wide nodes there is room for
};

/// The tree over the instances (accel/bvh_top.comp).
struct BvhTopParams {
    BvhPointers bvh;       // output: roots, top_nodes, top_order
    Instances instances;   // input [n_instances]
    Uints model_of;        // input [n_instances]
    Models models;         // input [n_models]
    Floats model_boxes;    // input [n_models,6] m, model frame: boxes of the first wide nodes, which are the roots
    Floats boxes;          // scratch [n_instances + nodes,6] m, world
    Uvec2s keys;           // scratch [power of two >= n_instances]
    uint n_instances;
    uint n_padded;         // that power of two
};

/// Surface-area cost (accel/bvh_cost.comp).
struct BvhCostParams {
    BvhWide wide;
    Floats boxes;     // input [n,6] of surfels
    Floats partial;   // output [n_groups] m^2
    uint bound;
};

RELIDAR_SHARED_END
#endif
