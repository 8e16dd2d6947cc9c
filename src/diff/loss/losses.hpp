// SPDX-License-Identifier: Apache-2.0
// What makes each loss that the list of terms names (relidar/diff/loss_terms.h):
// make_image_loss, make_surfel_loss and so on. A loss's own file defines it.
#pragma once

#include <relidar/diff/loss.hpp>

namespace relidar {

using LossMaker = std::unique_ptr<Loss>(Device& device, const LossWeights& weights, std::uint32_t n_rays);

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) LossMaker make_##maker##_loss;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // terms of one loss declare it again
#undef RELIDAR_TERM

}  // namespace relidar
