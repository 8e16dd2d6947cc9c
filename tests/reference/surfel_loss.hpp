// SPDX-License-Identifier: Apache-2.0
// Terms of a surfel's parameters themselves in double: leaving the box of an actor, entropy of the opacity (docs/method.md sections 5, 6).
#pragma once

#include <array>
#include <optional>

namespace relidar::reference {

/// Box of an actor.
struct Box {
    std::array<double, 3> half_size_m{};
    double largest_scale_m = 0.0;
};

/// The parameters the terms look at, or their derivatives.
struct BoxedSurfel {
    std::array<double, 3> mean{};        ///< box frame, metres
    std::array<double, 2> log_scale{};
    std::optional<double> log_scale_w{};   ///< of a 3D Gaussian
};

/// sum_xyz max(0, |mean| / half - 1) + sum over scales max(0, scale / largest - 1); adds scale * derivative
double box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& d);

/// Entropy of sigmoid(logit). @param derivative receives d(entropy)/d(logit)
double opacity_entropy(double logit, double& derivative);

}  // namespace relidar::reference
