// SPDX-License-Identifier: Apache-2.0
// Parameters of the losses (paper, Eq. 10-11) and their derivatives. Each loss weight is
// already divided by the number of averaged elements. Ray k of a launch uses entry
// first_ray + k * ray_stride of the targets, but entry k of rendered values and
// gradients.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LOSS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LOSS_H
#include "relidar/diff/loss_terms.h"
#include "../../scene/shared/scene.h"
#include "trace.h"

RELIDAR_SHARED_BEGIN

// Defines kTerm_depth, kTerm_intensity, ...: columns of the loss terms in array `terms`.
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) const uint kTerm_##name = index;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM

struct ImageLossParams {
    RenderedRays rendered;                // input [n_rays]
    Targets targets;                      // input
    RayGradients upstream;                // output [n_rays]
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated: one row
    float depth_weight;
    float intensity_weight;
    float drop_weight;
    // Weight of the loss (1 - sum of blending weights)^2 for rays with a return.
    float opacity_weight;
    float intensity_delta;  // Threshold of the Huber loss of the intensity. 0 selects the L1 loss.
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    // 1: the depth loss uses the blended depth divided by the sum of the blending
    // weights. 0: it uses the blended depth, as in the LiDAR-RT paper.
    uint normalised_depth;
};

// Number of floats per pixel in SsimParams::statistics, for the window around the pixel:
// dL/d(mean), 2 dL/d(variance), dL/d(covariance) of the loss L, means of both images.
#define RELIDAR_SSIM_FLOATS 5

/// Parameters of the kernels loss/ssim and loss/ssim_vjp, which compute the structural
/// similarity of the intensity image and its derivative. Kernel ssim_vjp reads the
/// `statistics` that ssim has written.
struct SsimParams {
    RenderedRays rendered;  // input [rows,columns]
    Targets targets;        // input
    // [rows,columns,RELIDAR_SSIM_FLOATS] Output of ssim, input of ssim_vjp.
    RELIDAR_OF(Floats, SsimStatistics) statistics;
    RayGradients upstream;                // [rows,columns] accumulated by ssim_vjp
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated by ssim
    float weight;  // Weight of the loss 1 - S of one pixel. S is the structural similarity.
    uint first_ray;
    uint ray_stride;
    uint rows;
    uint columns;
    uint circular;  // 1: the first column follows the last column
};

// Value of all three coordinates of a point that does not exist.
#define RELIDAR_NO_POINT 1e30
#define RELIDAR_NO_INDEX 0xffffffffu

struct ChamferPointsParams {
    Rays rays;              // input
    RenderedRays rendered;  // input [n_rays]
    Targets targets;        // input
    // Output [n_rays], m: simulated points relative to the origin of the first ray.
    RELIDAR_OF(Vec3s, SimulatedPoints) simulated;
    RELIDAR_OF(Vec3s, MeasuredPoints) measured;  // output [n_rays]
    RELIDAR_OF(Floats, PointCounts) counts;      // accumulated [2] simulated, measured points
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;  // 1: the range of a simulated point is D / W. 0: the range is D.
};

/// The elements of a tile are points, or the boxes of smaller tiles.
struct ChamferBoxesParams {
    RELIDAR_OF(Vec3s, LowCorners) low;    // input [rows,columns]
    RELIDAR_OF(Vec3s, HighCorners) high;  // input [rows,columns]
    // Output [tiles], row by row: lower corner of each tile's box. RELIDAR_NO_POINT for
    // an empty tile.
    RELIDAR_OF(Vec3s, TileLows) tile_low;
    RELIDAR_OF(Vec3s, TileHighs) tile_high;  // output [tiles]
    uint rows;
    uint columns;
    uint tile_rows;
    uint tile_columns;
};

/// Point cloud with image layout. Two levels of bounding boxes speed up nearest-point
/// searches.
struct ChamferCloud {
    RELIDAR_OF(Vec3s, CloudPoints) points;  // [rows,columns]
    RELIDAR_OF(Vec3s, TileLows) tile_low;   // boxes over tile_rows x tile_columns points
    RELIDAR_OF(Vec3s, TileHighs) tile_high;
    RELIDAR_OF(Vec3s, GroupLows) group_low;  // boxes over tile_rows x tile_columns tiles
    RELIDAR_OF(Vec3s, GroupHighs) group_high;
};

struct ChamferNearestParams {
    RELIDAR_OF(Vec3s, QueryPoints) queries;  // input [rows,columns]
    ChamferCloud cloud;                      // input
    // Output [rows,columns]: index of the nearest point in cloud.points. RELIDAR_NO_INDEX
    // if the pixel has no query point or the cloud is empty.
    Uints nearest;
    uint rows;
    uint columns;
    uint tile_rows;
    uint tile_columns;
};

struct ChamferParams {
    Rays rays;                                     // input
    RenderedRays rendered;                         // input [n_rays]
    RELIDAR_OF(Vec3s, SimulatedPoints) simulated;  // input [n_rays]
    RELIDAR_OF(Vec3s, MeasuredPoints) measured;    // input [n_rays]
    // input [n_rays] index, per simulated point
    RELIDAR_OF(Uints, NearestMeasured) nearest_measured;
    // input [n_rays] index, per measured point
    RELIDAR_OF(Uints, NearestSimulated) nearest_simulated;
    RELIDAR_OF(Floats, PointCounts) counts;  // input [2]
    // Several measured points may have the same nearest simulated point. For each
    // simulated point [n_rays,2]: derivative of the sum of their squared distances by the
    // simulated range, m, as a fixed-point number of two words. Kernel chamfer adds to
    // it, and kernel chamfer_vjp reads it.
    RELIDAR_OF(Uints, FoundGradients) d_nearest_simulated;
    RayGradients upstream;                // accumulated [n_rays] by chamfer_vjp
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated by chamfer
    float weight;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;
};

struct SurfelLossParams {
    SurfelPointers surfels;    // input
    SurfelPointers d_surfels;  // accumulated: mean, log_scale
    // Input [n]: 0 if the gradients of a surfel are undefined, otherwise 1. If the
    // address is 0, all gradients are defined.
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated
    Models models;                        // input [n_models]
    // Scale above which a surfel is penalised, relative to half the diagonal of the
    // actor's box.
    float box_scale_share;
    float box_weight;
    uint first_surfel;  // first surfel of the launch
    uint n_surfels;     // number of surfels of the launch
    uint n_models;
};

RELIDAR_SHARED_END
#endif
