// SPDX-License-Identifier: Apache-2.0
// Computes a loss term of the surfel parameters in double: the penalty for leaving the
// box of an actor (docs/method.md section 5).
#pragma once

#include <array>
#include <optional>

namespace relidar::reference {

struct Box {
    std::array<double, 3> half_size_m{};
    double largest_scale_m = 0.0;
};

struct BoxedSurfel {
    std::array<double, 3> mean{};  ///< box frame, metres
    std::array<double, 2> log_scale{};
    std::optional<double> log_scale_w{};  ///< third scale of a 3D Gaussian
};

/// Returns sum over x, y, z of max(0, |mean| / half - 1), plus sum over scales of max(0,
/// scale / largest - 1). Adds `scale` times the derivative to `gradient`.
double compute_box_loss(const BoxedSurfel& surfel, const Box& box, double scale, BoxedSurfel& gradient);

}  // namespace relidar::reference
