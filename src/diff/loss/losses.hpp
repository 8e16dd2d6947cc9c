// SPDX-License-Identifier: Apache-2.0
// Declares one factory function per loss: make_image_loss, make_surfel_loss and so on.
// The names come from the list in relidar/diff/loss_terms.h. The file of each loss
// defines its function.
#pragma once

#include <relidar/diff/loss.hpp>

namespace relidar {

using LossMaker = std::unique_ptr<Loss>(Device& device, const LossWeights& weights, std::uint32_t n_rays);

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) LossMaker make_##maker##_loss;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // terms of one loss repeat the declaration
#undef RELIDAR_TERM

}  // namespace relidar
