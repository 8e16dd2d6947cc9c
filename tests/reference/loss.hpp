// SPDX-License-Identifier: Apache-2.0
// Computes the loss terms of each ray (docs/method.md section 5) in double, and their
// derivatives with respect to the rendered values. The terms are L1 of depth, L1 or Huber
// loss of intensity (both only for rays with a return), and cross-entropy of the ray-drop
// probability beta = softmax(hit, drop) (M6).
#pragma once

#include <vector>

#include "render.hpp"

namespace relidar::reference {

struct LossWeights {
    double depth = 0.1;
    double intensity = 0.1;
    double drop = 0.01;
    double intensity_delta = 0.0;  ///< delta of the Huber loss; 0: L1
};

/// Rendered value that the depth term compares with the measured range.
enum class DepthKind { blended, normalised };  ///< D, or D / W (rays with W = 0 are skipped)

struct Target {
    double range_m = 0.0;  ///< 0 = dropped
    double intensity = 0.0;
};

struct LossTerms {
    double depth = 0.0;  ///< mean |depth - range| over returned rays, metres
    /// mean of |intensity - measured|, or of the Huber loss, over rays with a return
    double intensity = 0.0;
    /// mean of -[y ln beta + (1 - y) ln(1 - beta)] over all rays, where y = 1 for dropped
    /// rays
    double drop = 0.0;
    double total = 0.0;  ///< weighted sum
};

/// Computes all loss terms. The derivative of |x| at 0 is 0.
/// @param d_pixels if not null, receives d(total)/d(pixel) [n]
LossTerms evaluate_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                        const LossWeights& weights, DepthKind kind,
                        std::vector<PixelGradient>* d_pixels = nullptr);

/// Returns the mean of -ln(floor + (1 - floor) S) over the rays with a return, where S is
/// the likelihood of the pixel (M12).
/// @param d_pixels [n] if not null, receives the derivatives
double compute_likelihood_loss(const std::vector<Pixel>& pixels, const std::vector<Target>& targets,
                               double floor, std::vector<PixelGradient>* d_pixels = nullptr);

/// Returns the drop probability beta from the two blended logits (M6).
double drop_probability(double hit_logit, double drop_logit);

}  // namespace relidar::reference
