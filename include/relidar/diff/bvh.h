// SPDX-License-Identifier: Apache-2.0
// Software acceleration structure: wide nodes with quantised child boxes (after Ylitie et
// al., "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", 2017).
// Each model has a tree over its surfels, in the model's frame. A top-level tree contains
// the instances, in the world frame. The trees are built and refitted on the device.
#ifndef RELIDAR_INCLUDED_DIFF_BVH_H
#define RELIDAR_INCLUDED_DIFF_BVH_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_BVH_WIDTH 8
#define RELIDAR_BVH_LEAF_SIZE 4u  // Maximum number of primitives in one leaf slot.
#define RELIDAR_BVH_NO_NODE 0xffffffffu

/// Node with at most 8 children: 80 bytes. The box of a child along an axis is origin + q
/// 2^(e - 127), q = 0..255, rounded outward. A slot is inner (its bit in inner_mask is
/// set), a leaf (its count is above 0), or empty (neither; its box is inverted: low 255,
/// high 0).
struct BvhNode {
    vec3 origin;  // Lower corner of the node's box, metres.
    // Biased exponents e: x in bits 0-7, y in bits 8-15, z in bits 16-23. Bits 24-31 are
    // inner_mask.
    uint exponents;
    // Node index of the first inner slot; the node of an inner slot is first_child + the
    // number of inner slots before it.
    uint first_child;
    // Index in `order` of the node's leaves; a leaf slot starts at first_leaf + its
    // offset.
    uint first_leaf;
    // One byte per slot: offset in bits 0-4, count in bits 5-7; 0 for inner and empty
    // slots.
    uint leaves[2];
    uint low_x[2];  // Quantised bounds, one byte per slot.
    uint low_y[2];
    uint low_z[2];
    uint high_x[2];
    uint high_y[2];
    uint high_z[2];
};
RELIDAR_POINTER(BvhNodes, BvhNode);

RELIDAR_HANDLE(TlasHandle);  // Top-level structure of the driver.

// Cull mask of instances in the driver's structure: bit of models at rest. Moving models
// use the following bits.
#define RELIDAR_STANDING_MASK 1u
#define RELIDAR_MOVING_MASKS 7u  // Number of cull mask bits for moving models.

/// Model that moves during a sweep, for ray queries. A separate query searches only this
/// model, with the ray transformed to the pose that the driver's structure has for it.
struct MovingInstance {
    uint instance;
    uint model;
    uint mask;  // Cull mask bit of the model, which other models may share.
};
RELIDAR_POINTER(MovingInstances, MovingInstance);

/// Two-level tree as traversal kernels read it.
struct BvhPointers {
    BvhNodes nodes;  // Nodes of all models.
    // Surfels in leaf order, as indices relative to the first surfel of their model.
    RELIDAR_OF(Uints, LeafOrder) order;
    // Index in `nodes` of the root of each instance's model, [n_instances];
    // RELIDAR_BVH_NO_NODE if the model has no surfels or the instance is absent.
    RELIDAR_OF(Uints, InstanceRoots) roots;
    BvhNodes top_nodes;  // Nodes of the top-level tree over the instances; node 0 is the root.
    RELIDAR_OF(Uints, TopOrder) top_order;  // Instances in leaf order.
};

RELIDAR_SHARED_END
#endif
