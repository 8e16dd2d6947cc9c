// SPDX-License-Identifier: Apache-2.0
// Functions that create each loss of the term list (relidar/diff/loss_terms.h):
// make_image_loss, make_surfel_loss and so on. The file of a loss defines its function.
#pragma once

#include <relidar/diff/loss.hpp>

namespace relidar {

using LossMaker = std::unique_ptr<Loss>(Device& device, const LossWeights& weights, std::uint32_t n_rays);

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) LossMaker make_##maker##_loss;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // terms of one loss repeat the declaration
#undef RELIDAR_TERM

}  // namespace relidar
