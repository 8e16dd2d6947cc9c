// SPDX-License-Identifier: Apache-2.0
// List of all loss terms, one per line. C++ and GLSL generate the loss weights, the
// settings `loss.*`, the names in logs and the indices of the terms from this list.
#ifndef RELIDAR_INCLUDED_DIFF_LOSS_TERMS_H
#define RELIDAR_INCLUDED_DIFF_LOSS_TERMS_H

/// TERM(index, name, setting of its weight, default weight, accepted values, meaning)
/// describes one term. A loss computes one or more terms.
#define RELIDAR_LOSS_TERMS(TERM)                                                                             \
    TERM(0u, depth, depth, 0.1f, accept_at_least(0),                                                         \
         "weight of the range loss: L1 distance over rays with a return")                                    \
    TERM(1u, intensity, intensity, 0.1f, accept_at_least(0),                                                 \
         "weight of the intensity loss over rays with a return")                                             \
    TERM(2u, drop, drop, 0.01f, accept_at_least(0),                                                          \
         "weight of the ray-drop loss: cross-entropy over all rays")                                         \
    TERM(3u, opacity, opacity, 0.0f, accept_at_least(0),                                                     \
         mark_expert("weight of the opacity loss (1 - W)^2 over rays with a return; W: sum of the blending " \
                     "weights of a ray"))                                                                    \
    TERM(4u, ssim, intensity_ssim, 0.0f, accept_between(0, 1),                                               \
         mark_expert("weight of 1 - SSIM within the intensity loss, from 0 to 1; "                           \
                     "the Huber or L1 loss gets the remaining weight; needs rays in rows and columns; "      \
                     "0: as in the paper"))                                                                  \
    TERM(5u, box, box, 0.0f, accept_at_least(0),                                                             \
         mark_expert("weight of the loss for surfels of actors outside their box; 0: as in the paper"))      \
    TERM(6u, chamfer, chamfer, 0.01f, accept_at_least(0),                                                    \
         mark_expert("weight of the Chamfer distance between simulated and real points, in squared metres")) \
    TERM(7u, likelihood, likelihood, 0.0f, accept_at_least(0),                                               \
         mark_expert("weight of the negative log-likelihood of the measured range "                          \
                     "given the hits of the ray, averaged over rays with a return; 0: as in the paper"))

// Column of the loss terms to which the losses of a program add their values
// (TrainSession::losses). It follows the columns of the list above.
#define RELIDAR_CUSTOM_TERM 8u

#endif
