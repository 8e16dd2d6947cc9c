// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that select batches of rays and compute the gradients of the
// sensor poses.
#ifndef RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#define RELIDAR_INCLUDED_TRAIN_SHARED_TRAIN_H
#include "../../diff/shared/trace.h"

RELIDAR_SHARED_BEGIN

// Number of neighbouring columns in a group. A CPU traces eight rays together, in tiles
// of 4 columns x 2 rows. A group is as wide as such a tile.
#define RELIDAR_COLUMN_GROUP 4u

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

/// Weights of two sensor poses for the pose at the firing time of a ray. Pose `left` has
/// the weight 1 - s, and the next pose has the weight s.
struct PoseInterpolation {
    uint left;
    float s;
};
RELIDAR_DECLARE_POINTER(PoseInterpolations, PoseInterpolation);

/// Pose of the sensor at one time, and its correction in the world frame.
struct PoseKnot {
    vec3 position;     // uncorrected position, m
    vec3 translation;  // correction of the position, m
    vec3 rotation;     // correction of the rotation: rotation vector, rad
};
RELIDAR_DECLARE_POINTER(PoseKnots, PoseKnot);

struct MoveRaysParams {
    Rays rays;                          // input [n_rays]
    PoseInterpolations interpolations;  // input [n_rays]
    PoseKnots knots;                    // input: the knots of this frame
    Rays moved;                         // output [n_rays]
    uint n_rays;
};

#define RELIDAR_KNOT_WORKGROUP 256

/// Parameters of train/knot_gradients.comp, which converts gradients of rays to gradients
/// of sensor pose corrections. Ray k of a batch (a subset of the rays of a frame) is
/// moved[first_ray + k * ray_stride]. If `columns` is 0, `moved` contains all rays of the
/// frame. Otherwise it contains copies of only some columns.
struct KnotGradientsParams {
    Rays moved;                         // input
    PoseInterpolations interpolations;  // Input: position of each ray of the frame between two sensor poses.
    PoseKnots knots;                    // input
    RELIDAR_OF(Floats, DeviceRayGradients) d_rays;  // input [n_rays,6]
    // Output [n_rows,n_knots,6]: dL/d(translation) and dL/d(rotation) of each sensor
    // pose. Each row is the sum over the rays of one workgroup.
    RELIDAR_OF(Floats, KnotGradientRows) rows;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;  // Number of columns of the frame. 0 means that the batch was not copied from columns.
    uint first_column;
    uint column_stride;
    uint n_columns;
    uint n_knots;
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
