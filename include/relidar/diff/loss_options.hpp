// SPDX-License-Identifier: Apache-2.0
// The terms of the loss that training minimises (Eq. 10-11) and their weights. What
// computes them is in relidar/diff/loss.hpp.
#pragma once

#include <array>
#include <cstddef>

#include <relidar/diff/loss_terms.h>

namespace relidar {

/// Weights of the terms (relidar/diff/loss_terms.h), each a mean over its pixels, points
/// or surfels; and what else there is to choose.
struct LossWeights {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) float setting = standard;
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    bool normalised_depth = false;  ///< compare D / W instead of D (paper)
    /// Huber loss of intensities: up to this error squared, beyond it linear; 0: L1
    /// (paper)
    float intensity_delta = 0.0f;
    /// standard deviation an actor's surfel may have, over half the diagonal of its box
    float box_scale_share = 0.2f;
    float likelihood_scale_m = 0.05f;  ///< spread of measured ranges about what is there, metres
    float likelihood_floor = 0.01f;    ///< share of returns that may lie anywhere

    bool operator==(const LossWeights&) const = default;
};

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) #name,
/// in the order of their places
inline constexpr std::array kLossTermNames{RELIDAR_LOSS_TERMS(RELIDAR_TERM)};
#undef RELIDAR_TERM
inline constexpr int kLossTerms = kLossTermNames.size();

/// Place of each term in a row of terms: loss_term::depth, ...
namespace loss_term {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    inline constexpr std::size_t name = index;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // a constant each
#undef RELIDAR_TERM
}  // namespace loss_term

}  // namespace relidar
