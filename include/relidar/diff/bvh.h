// SPDX-License-Identifier: Apache-2.0
// The software acceleration structure: wide nodes with quantised child boxes (after
// Ylitie et al., "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
// BVHs", 2017). One tree a model over its surfels, in the model's frame; one top tree
// over the instances, in the world. Built and refitted on the device.
#ifndef RELIDAR_INCLUDED_DIFF_BVH_H
#define RELIDAR_INCLUDED_DIFF_BVH_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_BVH_WIDTH 8
#define RELIDAR_BVH_LEAF_SIZE 4u  // primitives of one leaf slot, at most
#define RELIDAR_BVH_NO_NODE 0xffffffffu

/// A node over at most 8 children: 80 bytes. A child's box along an axis is origin + q
/// 2^(e - 127), q = 0..255, rounded outward. A slot is inner (its bit in inner_mask), a
/// leaf (its count > 0) or empty (neither; its box is inverted: lo 255, hi 0).
struct BvhNode {
    vec3 origin;       // low corner of the node's box, m
    uint exponents;    // biased exponents e: x in bits 0-7, y in 8-15, z in 16-23; inner_mask in 24-31
    uint first_child;  // inner slot: node first_child + number of inner slots before it
    uint first_leaf;   // leaf slot: entries first_leaf + offset ... of `order`
    uint leaves[2];    // a byte a slot: bits 0-4 offset, bits 5-7 count; 0 for inner and empty slots
    uint low_x[2];     // a byte a slot
    uint low_y[2];
    uint low_z[2];
    uint high_x[2];
    uint high_y[2];
    uint high_z[2];
};
RELIDAR_POINTER(BvhNodes, BvhNode);

RELIDAR_HANDLE(TlasHandle);  // of the driver's top level

// Bits of the cull mask of a driver's instances: models that stand still, and the first
// of those for models that move.
#define RELIDAR_STANDING_MASK 1u
#define RELIDAR_MOVING_MASKS 7u  // bits

/// A model that moves during a sweep, as a ray query looks for it: by itself, with the
/// ray moved to where the driver's tree has the model.
struct MovingInstance {
    uint instance;
    uint model;
    uint mask;  // of its cull mask; others may have it too
};
RELIDAR_POINTER(MovingInstances, MovingInstance);

/// A two-level structure as a traversal reads it.
struct BvhPointers {
    BvhNodes nodes;                      // of all models
    RELIDAR_OF(Uints, LeafOrder) order;  // surfels in leaf order, counted from the first of their model
    // [n_instances] root of the instance's model in `nodes`; RELIDAR_BVH_NO_NODE: no
    // surfels, or not placed
    RELIDAR_OF(Uints, InstanceRoots) roots;
    BvhNodes top_nodes;                     // over the instances; root 0
    RELIDAR_OF(Uints, TopOrder) top_order;  // instances in leaf order
};

RELIDAR_SHARED_END
#endif
