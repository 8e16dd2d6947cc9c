// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernel robust_loss. C++ and GLSL share this file.
#ifndef ROBUST_LOSS_H
#define ROBUST_LOSS_H
#include "relidar/diff/loss_terms.h"
#include "relidar/diff/rays.h"

RELIDAR_SHARED_BEGIN

struct RobustLossParams {
    RenderedRays rendered;                // input [n_rays]
    Targets targets;                      // input: ray k uses entry first_ray + k * ray_stride
    RayGradients upstream;                // accumulated [n_rays]
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated: one row
    float weight;                         // weight of one ray
    float scale_m;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
};

RELIDAR_SHARED_END
#endif
