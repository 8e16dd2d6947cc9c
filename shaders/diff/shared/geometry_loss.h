// SPDX-License-Identifier: Apache-2.0
// The geometric losses (docs/method.md M10-M12). Weights, rays and targets as in loss.h.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_GEOMETRY_LOSS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_GEOMETRY_LOSS_H
#include "loss.h"

RELIDAR_SHARED_BEGIN

/// Distortion, normal consistency and likelihood: loss/geometry_loss writes `d_tangents`,
/// loss/normal_vjp reads them.
struct GeometryLossParams {
    Rays rays;                    // input
    RenderedRays rendered;        // input [n_rays]
    RenderedGeometries geometry;  // input [n_rays]
    Targets targets;              // input
    // [n_rays,2] by the difference of the points right and left of a pixel, and below and
    // above it
    Vec3s d_tangents;
    RayGradients upstream;                // accumulated [n_rays]
    GeometryGradients d_geometry;         // output [n_rays]; point and range of normal_vjp
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated
    float distortion_weight;
    float normal_weight;  // 0: the batch need not be an image
    float likelihood_weight;
    float likelihood_floor;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint rows;
    uint columns;
    uint circular;          // 1: the first column follows the last one
    uint normalised_depth;  // 1: range D / W, 0: D
};

RELIDAR_SHARED_END
#endif
