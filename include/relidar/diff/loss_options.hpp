// SPDX-License-Identifier: Apache-2.0
// Weights and options of the training loss (paper, Eq. 10-11). relidar/diff/loss.hpp
// computes the loss.
#pragma once

#include <array>
#include <cstddef>

#include <relidar/diff/loss_terms.h>

namespace relidar {

/// Weights and options of the loss terms (relidar/diff/loss_terms.h). Each term is a mean
/// over pixels, points or surfels.
struct LossWeights {
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) float setting = standard;
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    /// If true, the range term uses the normalised range D / W, where D is the blended
    /// range and W the blended weight. If false, it uses D (paper).
    bool normalised_depth = false;
    /// Largest error for which the Huber loss of intensities is quadratic. For larger
    /// errors, the loss is linear. 0 = L1 loss (paper).
    float intensity_delta = 0.0f;
    /// Largest allowed standard deviation of an actor's surfel, as a fraction of half the
    /// box diagonal.
    float box_scale_share = 0.2f;
    /// Scale of the spread of measured ranges around the true surface, metres.
    float likelihood_scale_m = 0.05f;
    /// Assumed fraction of returns that are outliers. An outlier can have any range with
    /// equal probability.
    float likelihood_floor = 0.01f;

    bool operator==(const LossWeights&) const = default;
};

#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) #name,
/// Names of the loss terms, in the order of their indices. The last term is the sum of
/// the losses of a program (TrainSession::losses).
inline constexpr std::array kLossTermNames{RELIDAR_LOSS_TERMS(RELIDAR_TERM) "custom"};
#undef RELIDAR_TERM
inline constexpr int kLossTerms = kLossTermNames.size();
static_assert(kLossTerms == RELIDAR_CUSTOM_TERM + 1);

/// Index of each term in a row of loss terms, for example loss_term::depth.
namespace loss_term {
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) \
    inline constexpr std::size_t name = index;
RELIDAR_LOSS_TERMS(RELIDAR_TERM)  // Defines one constant per term.
#undef RELIDAR_TERM
inline constexpr std::size_t custom = RELIDAR_CUSTOM_TERM;
}  // namespace loss_term

}  // namespace relidar
