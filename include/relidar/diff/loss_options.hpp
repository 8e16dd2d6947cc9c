// SPDX-License-Identifier: Apache-2.0
// Terms of the training loss (Eq. 10-11) and their weights. relidar/diff/loss.hpp
// computes them.
#pragma once

#include <array>
#include <cstddef>

#include <relidar/diff/loss_terms.h>

namespace relidar {

/// Weights and options of the loss terms (relidar/diff/loss_terms.h). Each term is a mean
/// over its pixels, points or surfels.
struct LossWeights {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) float setting = standard;
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    bool normalised_depth = false;  ///< If true, the range term compares D / W instead of D (paper).
    /// Threshold of the Huber loss of intensities: quadratic up to this error, linear
    /// beyond; 0 = L1 (paper).
    float intensity_delta = 0.0f;
    /// Largest standard deviation of an actor's surfel, relative to half the diagonal of
    /// its box.
    float box_scale_share = 0.2f;
    float likelihood_scale_m = 0.05f;  ///< Spread of measured ranges around the true surface, metres.
    float likelihood_floor = 0.01f;    ///< Share of returns that may have any range.

    bool operator==(const LossWeights&) const = default;
};

#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) #name,
/// Names of the loss terms, in the order of their indices.
inline constexpr std::array kLossTermNames{RELIDAR_LOSS_TERMS(RELIDAR_TERM)};
#undef RELIDAR_TERM
inline constexpr int kLossTerms = kLossTermNames.size();

/// Index of each term in a row of terms: loss_term::depth, ...
namespace loss_term {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    inline constexpr std::size_t name = index;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // One constant per term.
#undef RELIDAR_TERM
}  // namespace loss_term

}  // namespace relidar
