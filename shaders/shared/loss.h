// SPDX-License-Identifier: Apache-2.0
// Image losses (Eq. 10): depth L1, intensity L1, ray-drop cross-entropy, and their derivative.
#ifndef RELIDAR_INCLUDED_SHARED_LOSS_H
#define RELIDAR_INCLUDED_SHARED_LOSS_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_LOSS_TERMS 4   // depth, intensity, drop, weight

struct ImageLossParams {
    RenderedRays rendered;     // input [n_rays]
    Targets targets;           // input, ray k of the launch is entry first_ray + k * ray_stride
    RayGradients upstream;     // output [n_rays]
    Floats terms;              // output [n_rays,4] weighted loss terms
    float depth_weight;        // each already divided by the number of pixels it is averaged over
    float intensity_weight;
    float drop_weight;
    float opacity_weight;      // (1 - W)^2 on returned pixels
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint normalised_depth;     // 1: compare D / W, 0: compare D (paper)
};

RELIDAR_SHARED_END
#endif
