// SPDX-License-Identifier: Apache-2.0
// Parameters of the geometric losses (docs/method.md M10-M12). Weights, rays and targets
// are as in loss.h.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_GEOMETRY_LOSS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_GEOMETRY_LOSS_H
#include "loss.h"

RELIDAR_SHARED_BEGIN

/// Parameters of distortion, normal consistency and likelihood. Kernel loss/geometry_loss
/// writes `d_tangents`, and loss/normal_vjp reads it.
struct GeometryLossParams {
    Rays rays;                    // input
    RenderedRays rendered;        // input [n_rays]
    RenderedGeometries geometry;  // input [n_rays]
    Targets targets;              // input
    // [n_rays,2] Gradient with respect to two differences of points: right minus left
    // neighbour, and below minus above.
    Vec3s d_tangents;
    RayGradients upstream;                // accumulated [n_rays]
    GeometryGradients d_geometry;         // output [n_rays]; normal_vjp writes the point and the range
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated
    float distortion_weight;
    float normal_weight;  // 0: the batch does not need to be an image
    float likelihood_weight;
    float likelihood_floor;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint rows;
    uint columns;
    uint circular;          // 1: the first column follows the last column
    uint normalised_depth;  // 1: the range is D / W, 0: the range is D
};

RELIDAR_SHARED_END
#endif
