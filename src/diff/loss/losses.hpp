// SPDX-License-Identifier: Apache-2.0
// Declares one factory function per loss, for example make_image_loss. The list in
// relidar/diff/loss_terms.h contains the names. Each loss has a separate source file that
// defines its function.
#pragma once

#include <relidar/diff/loss.hpp>

namespace relidar {

using LossFactory = std::unique_ptr<Loss>(Device& device, const LossWeights& weights, std::uint32_t n_rays);

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) LossFactory make_##maker##_loss;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // a loss with several terms is declared several times
#undef RELIDAR_TERM

}  // namespace relidar
