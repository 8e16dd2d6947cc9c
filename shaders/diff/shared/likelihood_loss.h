// SPDX-License-Identifier: Apache-2.0
// Parameters of the likelihood loss (docs/method.md M12). Weights, rays and targets have
// the same meaning as in loss.h.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LIKELIHOOD_LOSS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LIKELIHOOD_LOSS_H
#include "loss.h"

RELIDAR_SHARED_BEGIN

struct LikelihoodLossParams {
    RenderedRays rendered;                // input [n_rays]
    Targets targets;                      // input
    RayGradients upstream;                // accumulated [n_rays]
    RELIDAR_OF(Floats, LossTerms) terms;  // accumulated
    float weight;
    float likelihood_floor;  // Assumed share of returns whose range does not depend on the hits.
    uint n_rays;
    uint first_ray;
    uint ray_stride;
};

RELIDAR_SHARED_END
#endif
