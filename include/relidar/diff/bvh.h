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
#define RELIDAR_BVH_LEAF_SIZE 4u  // Maximum number of surfels or instances in one leaf.
#define RELIDAR_BVH_NO_NODE 0xffffffffu

/// Tree node with at most 8 child slots, 80 bytes. Along each axis, the bounds of a
/// child's box are origin + q 2^(e - 127), with q = 0..255 rounded outward. A slot holds
/// an inner node if its bit in inner_mask is set. A slot holds a leaf if its leaf has at
/// least one entry. Otherwise the slot is empty and has an inverted box (low 255, high
/// 0).
struct BvhNode {
    vec3 origin;  // Lower corner of the node's box, metres.
    // Four packed bytes, lowest first. Bytes 0-2 are the exponents e of the axes x, y, z:
    // child boxes are quantised in steps of 2^(e - 127) metres. Byte 3 is inner_mask: its
    // bit k is set if child k is an inner node.
    uint exponents;
    // Index of the first child that is an inner node, in the array of all tree nodes. The
    // other inner children follow directly after it, in the order of their slots.
    uint first_child;
    // The surfels of this node's leaves are consecutive entries of BvhPointers::order,
    // from this index on. The field `leaves` has the offset of each leaf from this index.
    // In the top-level tree, leaves hold instances, listed in BvhPointers::top_order.
    uint first_leaf;
    // One byte per child slot. For a leaf, bits 0-4 hold the offset of its first entry,
    // and bits 5-7 hold its number of entries. The byte is 0 if the slot holds no leaf.
    uint leaves[2];
    // Lower x bounds of the child boxes, quantised to one byte per child. The next five
    // fields hold the other bounds in the same form.
    uint low_x[2];
    uint low_y[2];
    uint low_z[2];
    uint high_x[2];
    uint high_y[2];
    uint high_z[2];
};
RELIDAR_DECLARE_POINTER(BvhNodes, BvhNode);

RELIDAR_DECLARE_HANDLE(TlasHandle);  // Handle of the driver's top-level acceleration structure.

// Bit of the ray query's cull mask for all instances that do not move during the sweep.
// Moving instances use the higher bits.
#define RELIDAR_STANDING_MASK 1u
#define RELIDAR_MOVING_MASKS 7u  // Number of cull mask bits for moving models.

/// Instance that moves during a sweep. The driver's acceleration structure stores only
/// one pose of an instance. Therefore a separate ray query tests this instance. In this
/// query, the ray is moved instead of the instance.
struct MovingInstance {
    uint instance;
    uint model;
    uint mask;  // Cull mask bit of the instance. Several moving instances may share a bit.
};
RELIDAR_DECLARE_POINTER(MovingInstances, MovingInstance);

/// Addresses of the two-level software tree that traversal kernels read.
struct BvhPointers {
    BvhNodes nodes;  // Tree nodes of all models.
    // Index of the surfel of each leaf entry, counted from the first surfel of its model.
    RELIDAR_OF(Uints, LeafOrder) order;
    // Root node of each instance's tree, as an index in `nodes`, [n_instances].
    // RELIDAR_BVH_NO_NODE if the model has no surfels or the instance is absent.
    RELIDAR_OF(Uints, InstanceRoots) roots;
    BvhNodes top_nodes;  // Nodes of the top-level tree over the instances. Node 0 is the root.
    RELIDAR_OF(Uints, TopOrder) top_order;  // Instance of each leaf entry in the top-level tree.
};

RELIDAR_SHARED_END
#endif
