// SPDX-License-Identifier: Apache-2.0
// Losses (Eq. 10-11) and their derivatives. A weight in a parameter struct is already
// divided by what its term is averaged over. Ray k of a launch is entry first_ray + k *
// ray_stride of its targets; rendered values and gradients are entry k.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LOSS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LOSS_H
#include "relidar/diff/loss_terms.h"
#include "../../scene/shared/scene.h"
#include "trace.h"

RELIDAR_SHARED_BEGIN

// kTerm_depth, ...: places in `terms`, a row of which holds one weighted value a term.
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) const uint kTerm_##name = index;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM

struct ImageLossParams {
    RenderedRays rendered;                // input [n_rays]
    Targets targets;                      // input
    RayGradients upstream;                // output [n_rays]
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated: a row
    float depth_weight;
    float intensity_weight;
    float drop_weight;
    float opacity_weight;   // (1 - W)^2 on returned pixels
    float intensity_delta;  // of the Huber loss; 0: L1
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;  // 1: compare D / W, 0: compare D (paper)
};

// a pixel: derivatives by mean, variance (twice) and covariance over the sum of weights,
// both means
#define RELIDAR_SSIM_FLOATS 5

/// Structural similarity of the intensity image and its derivative: loss/ssim writes
/// `statistics`, loss/ssim_vjp reads them.
struct SsimParams {
    RenderedRays rendered;  // input [rows,columns]
    Targets targets;        // input
    // [rows,columns,RELIDAR_SSIM_FLOATS] output of ssim, input of ssim_vjp
    RELIDAR_OF(Floats, SsimStatistics) statistics;
    RayGradients upstream;                // [rows,columns] accumulated by ssim_vjp
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated by ssim
    float weight;                         // of 1 - S of a pixel
    uint first_ray;
    uint ray_stride;
    uint rows;
    uint columns;
    uint circular;  // 1: the first column follows the last one
};

// every coordinate of a ray's point where the ray has none: farther than anything
#define RELIDAR_NO_POINT 1e30
#define RELIDAR_NO_INDEX 0xffffffffu

/// The simulated and the measured point of each ray.
struct ChamferPointsParams {
    Rays rays;              // input
    RenderedRays rendered;  // input [n_rays]
    Targets targets;        // input
    // output [n_rays] m, relative to the origin of the batch's first ray
    RELIDAR_OF(Vec3s, SimulatedPoints) simulated;
    RELIDAR_OF(Vec3s, MeasuredPoints) measured;  // output [n_rays]
    RELIDAR_OF(Floats, PointCounts) counts;      // accumulated [2] simulated, measured points
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;  // 1: range D / W, 0: D
};

/// Bounds of rectangles of points or of boxes (a point is a box with low = high).
struct ChamferBoxesParams {
    RELIDAR_OF(Vec3s, LowCorners) low;    // input [rows,columns]
    RELIDAR_OF(Vec3s, HighCorners) high;  // input [rows,columns]
    // output [tiles], row by row; RELIDAR_NO_POINT where the tile is empty
    RELIDAR_OF(Vec3s, TileLows) tile_low;
    RELIDAR_OF(Vec3s, TileHighs) tile_high;  // output [tiles]
    uint rows;
    uint columns;
    uint tile_rows;
    uint tile_columns;
};

/// A cloud in image order with two levels of boxes over it.
struct ChamferCloud {
    RELIDAR_OF(Vec3s, CloudPoints) points;  // [rows,columns]
    RELIDAR_OF(Vec3s, TileLows) tile_low;   // boxes over tile_rows x tile_columns points
    RELIDAR_OF(Vec3s, TileHighs) tile_high;
    RELIDAR_OF(Vec3s, GroupLows) group_low;  // boxes over as many tiles
    RELIDAR_OF(Vec3s, GroupHighs) group_high;
};

/// Nearest point of a cloud for every point of another one of the same shape.
struct ChamferNearestParams {
    RELIDAR_OF(Vec3s, QueryPoints) queries;  // input [rows,columns]
    ChamferCloud cloud;                      // input
    // output [rows,columns] index in cloud.points; RELIDAR_NO_INDEX where the query or
    // the whole cloud is no point
    Uints nearest;
    uint rows;
    uint columns;
    uint tile_rows;
    uint tile_columns;
};

/// Squared distances both ways (loss/chamfer) and their derivative with respect to the
/// simulated ranges (loss/chamfer_vjp).
struct ChamferParams {
    Rays rays;                                              // input
    RenderedRays rendered;                                  // input [n_rays]
    RELIDAR_OF(Vec3s, SimulatedPoints) simulated;           // input [n_rays]
    RELIDAR_OF(Vec3s, MeasuredPoints) measured;             // input [n_rays]
    RELIDAR_OF(Uints, NearestMeasured) nearest_measured;    // input [n_rays] of each simulated point
    RELIDAR_OF(Uints, NearestSimulated) nearest_simulated;  // input [n_rays] of each measured point
    RELIDAR_OF(Floats, PointCounts) counts;                 // input [2]
    // [n_rays,2] fixed point, m: accumulated by chamfer, input of chamfer_vjp
    RELIDAR_OF(Uints, FoundGradients) d_found;
    RayGradients upstream;                // accumulated [n_rays] by chamfer_vjp
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated by chamfer
    float weight;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;
};

/// A term of the parameters themselves: actors that leave their box.
struct SurfelLossParams {
    SurfelPointers surfels;    // input
    SurfelPointers d_surfels;  // accumulated: mean, log_scale
    // input [n] rows whose gradients are defined, or address 0 = all
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated
    Models models;                        // input [n_models]
    // standard deviations beyond this share of a box's half diagonal count as outside
    float box_scale_share;
    float box_weight;
    uint first_surfel;  // of the launch
    uint n_surfels;     // of the launch
    uint n_models;
};

RELIDAR_SHARED_END
#endif
