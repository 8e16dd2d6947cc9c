// SPDX-License-Identifier: Apache-2.0
// Losses (Eq. 10-11) and their derivatives. A weight in a parameter struct is already divided by what its term is averaged over.
// Ray k of a launch is entry first_ray + k * ray_stride of its targets; rendered values and gradients are entry k.
#ifndef RELIDAR_INCLUDED_SHARED_LOSS_H
#define RELIDAR_INCLUDED_SHARED_LOSS_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

// Entries of `terms`, in the order of kLossTermNames.
#define RELIDAR_TERM_DEPTH 0u
#define RELIDAR_TERM_INTENSITY 1u
#define RELIDAR_TERM_DROP 2u
#define RELIDAR_TERM_OPACITY 3u
#define RELIDAR_TERM_SSIM 4u
#define RELIDAR_TERM_BOX 5u
#define RELIDAR_TERM_ENTROPY 6u
#define RELIDAR_LOSS_TERMS 7

struct ImageLossParams {
    RenderedRays rendered;     // input [n_rays]
    Targets targets;           // input
    RayGradients upstream;     // output [n_rays]
    Floats terms;              // accumulated [RELIDAR_LOSS_TERMS] weighted loss terms
    float depth_weight;
    float intensity_weight;
    float drop_weight;
    float opacity_weight;      // (1 - W)^2 on returned pixels
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;     // 1: compare D / W, 0: compare D (paper)
};

#define RELIDAR_SSIM_FLOATS 5   // a pixel: derivatives by mean, variance (twice) and covariance over the sum of weights, both means

/// Structural similarity of the intensity image and its derivative: loss/ssim writes `statistics`, loss/ssim_vjp reads them.
struct SsimParams {
    RenderedRays rendered;     // input [rows,columns]
    Targets targets;           // input
    Floats statistics;         // [rows,columns,RELIDAR_SSIM_FLOATS] output of ssim, input of ssim_vjp
    RayGradients upstream;     // [rows,columns] accumulated by ssim_vjp
    Floats terms;              // accumulated by ssim
    float weight;              // of 1 - S of a pixel
    uint first_ray;
    uint ray_stride;
    uint rows;
    uint columns;
    uint circular;             // 1: the first column follows the last one
};

/// Terms of a model's parameters themselves: actors that leave their box, opacities between 0 and 1.
struct SurfelLossParams {
    SurfelPointers surfels;     // input
    SurfelPointers d_surfels;   // accumulated: mean, log_scale, opacity_logit
    Uints touched;              // input [n] rows whose gradients are defined, or address 0 = all
    Floats terms;               // accumulated
    vec3 half_size;             // of the model's box, m; 0: it has none
    float largest_scale;        // m: standard deviations beyond it count as outside
    float box_weight;
    float entropy_weight;
    uint first_surfel;          // of the model
    uint n_surfels;
};

RELIDAR_SHARED_END
#endif
