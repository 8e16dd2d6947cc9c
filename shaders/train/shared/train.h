// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels for batches of rays and for pose gradients.
#ifndef RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#define RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#include "../../diff/shared/trace.h"

RELIDAR_SHARED_BEGIN

// As wide as a tile of eight rays, which a CPU traces together (traversal/ray.glsl).
#define RELIDAR_COLUMN_GROUP 4u

/// Copies columns of a frame next to each other as a new image. The columns are groups of
/// RELIDAR_COLUMN_GROUP neighbours. The distance between two groups is column_stride
/// times their width, starting at first_column (train/columns.glsl). The frame wraps
/// around.
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

/// Position of a ray between poses of the sensor: it moves with (1 - s) of knot `left`
/// and s of the next knot.
struct RayPlace {
    uint left;
    float s;
};
RELIDAR_POINTER(RayPlaces, RayPlace);

/// A pose of the sensor and its correction, world frame.
struct PoseKnot {
    vec3 position;     // uncorrected position, m
    vec3 translation;  // correction of the position, m
    vec3 rotation;     // correction of the rotation: rotation vector, rad
};
RELIDAR_POINTER(PoseKnots, PoseKnot);

/// Computes the rays of a frame for the corrected poses.
struct MoveRaysParams {
    Rays rays;         // input [n_rays]
    RayPlaces places;  // input [n_rays]
    PoseKnots knots;   // input: the knots of this frame
    Rays moved;        // output [n_rays]
    uint n_rays;
};

#define RELIDAR_KNOT_WORKGROUP 256

/// Converts gradients of rays to gradients of the knots' corrections. Ray k of the batch
/// is entry first_ray + k * ray_stride of `moved`. It is the same entry of `places`,
/// unless the batch is a copy of columns.
struct KnotGradientsParams {
    Rays moved;                                     // input
    RayPlaces places;                               // input: places of the full frame
    PoseKnots knots;                                // input
    RELIDAR_OF(Floats, DeviceRayGradients) d_rays;  // input [n_rays,6]
    // output [n_rows,n_knots,6]: dL/d(translation), dL/d(rotation); each row is the sum
    // over the rays of a workgroup
    RELIDAR_OF(Floats, KnotGradientRows) rows;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;  // columns of the frame; 0: the batch is not a copy of columns
    uint first_column;
    uint column_stride;
    uint n_columns;
    uint n_knots;
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
