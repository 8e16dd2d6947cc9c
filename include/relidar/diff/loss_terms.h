// SPDX-License-Identifier: Apache-2.0
// List of all loss terms, one per line. C++ and GLSL generate the loss weights, the
// settings `loss.*`, the names in logs and the indices of the terms from this list.
#ifndef RELIDAR_INCLUDED_DIFF_LOSS_TERMS_H
#define RELIDAR_INCLUDED_DIFF_LOSS_TERMS_H

/// TERM(index, name, setting of its weight, loss that computes it, default weight,
/// accepted values, meaning) describes one term. A loss computes one or more terms. It is
/// created only if the weight of at least one of its terms is above 0.
#define RELIDAR_LOSS_TERMS(TERM)                                                                         \
    TERM(0u, depth, depth, image, 0.1f, at_least(0), "weight of the range term, L1 on returned rays")    \
    TERM(1u, intensity, intensity, image, 0.1f, at_least(0),                                             \
         "weight of the intensity term on returned rays")                                                \
    TERM(2u, drop, drop, image, 0.01f, at_least(0),                                                      \
         "weight of the ray-drop term, cross-entropy on all rays")                                       \
    TERM(3u, opacity, opacity, image, 0.0f, at_least(0), expert("weight of (1 - W)^2 on returned rays")) \
    TERM(4u, ssim, intensity_ssim, image, 0.0f, between(0, 1),                                           \
         expert("share of 1 - SSIM in the intensity term, beside Huber or L1; of a sensor with image "   \
                "order; 0: paper"))                                                                      \
    TERM(5u, box, box, surfel, 0.0f, at_least(0),                                                        \
         expert("weight of actors' surfels leaving their box; 0: paper"))                                \
    TERM(6u, chamfer, chamfer, chamfer, 0.01f, at_least(0),                                              \
         expert("weight of the Chamfer distance between simulated and measured points, squared metres")) \
    TERM(7u, likelihood, likelihood, likelihood, 0.0f, at_least(0),                                      \
         expert("weight of -ln of how likely a ray's hits make the range that was measured, mean over "  \
                "returned rays; 0: paper"))

#endif
