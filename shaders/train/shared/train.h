// SPDX-License-Identifier: Apache-2.0
// Batches of rays.
#ifndef RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#define RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#include "../../diff/shared/trace.h"

RELIDAR_SHARED_BEGIN

// as wide as the eight rays of a tile that a processor traces together
// (traversal/ray.glsl)
#define RELIDAR_COLUMN_GROUP 4u

/// Some columns of a frame, whole and one beside the other, as an image of their own:
/// groups of RELIDAR_COLUMN_GROUP neighbours, each column_stride times its width behind
/// the one before (train/columns.glsl), from first_column on. The frame wraps around.
struct GatherColumnsParams {
    Rays rays;              // input [rows,columns]
    Targets targets;        // input [rows,columns]
    Rays batch_rays;        // output [rows,n_columns]
    Targets batch_targets;  // output [rows,n_columns]
    uint rows;
    uint columns;
    uint first_column;
    uint column_stride;
    uint n_columns;
};

/// A ray's place among the poses of the sensor: it moves with (1 - s) of knot `left` and
/// s of the next one.
struct RayPlace {
    uint left;
    float s;
};
RELIDAR_POINTER(RayPlaces, RayPlace);

/// A pose of the sensor and its correction, world.
struct PoseKnot {
    vec3 position;     // uncorrected, m
    vec3 translation;  // m
    vec3 rotation;     // rotation vector, rad
};
RELIDAR_POINTER(PoseKnots, PoseKnot);

/// A frame's rays as the corrected poses have them.
struct MoveRaysParams {
    Rays rays;         // input [n_rays]
    RayPlaces places;  // input [n_rays]
    PoseKnots knots;   // input, those of this frame
    Rays moved;        // output [n_rays]
    uint n_rays;
};

#define RELIDAR_KNOT_WORKGROUP 256

/// Gradients of rays as gradients of the knots' corrections. Ray k of the batch is entry
/// first_ray + k * ray_stride of `moved`, and of `places` too unless it was gathered from
/// a window of columns.
struct KnotGradientsParams {
    Rays moved;                                     // input
    RayPlaces places;                               // input, of the whole frame
    PoseKnots knots;                                // input
    RELIDAR_OF(Floats, DeviceRayGradients) d_rays;  // input [n_rays,6]
    // output [n_rows,n_knots,6]: dL/d(translation), dL/d(rotation), sums over the rays of
    // a workgroup
    RELIDAR_OF(Floats, KnotGradientRows) rows;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;  // of the frame; 0 = the batch is no copy of columns
    uint first_column;
    uint column_stride;
    uint n_columns;
    uint n_knots;
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
