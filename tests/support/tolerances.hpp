// SPDX-License-Identifier: Apache-2.0
// The tolerances of the suite in one place, each with its reason (docs/architecture.md
// section 9).
#pragma once

namespace relidar::test {

/// Central differences of the double reference: truncation h^2 f'''/6 and cancellation
/// eps L / h balance near h = 1e-5 for lengths (surfels of some 0.2 m), lower for angles,
/// which move surfels 10 m away ten times as far, and higher for logits and SH
/// coefficients, in which the image is nearly linear.
inline constexpr double kDifferenceStep = 1e-5;
inline constexpr double kAngleStep = 1e-6;
inline constexpr double kLogitStep = 1e-4;
/// Reference backward against these differences, relative to the row's norm.
inline constexpr double kReferenceGradient = 1e-6;
/// Rows smaller than this share of the largest row of their group are compared against
/// that share: below it the differences hold no digits (cancellation is absolute, about
/// 1e-10).
inline constexpr double kSmallRow = 3e-3;
/// Kernel against double reference backward, relative to the row's norm: single precision
/// with some tens of hits a ray.
inline constexpr double kKernelGradient = 1e-4;
/// What Vulkan lets single precision be off, relative to the result: by one rounding, by
/// exp (3 + 2 |x| units in the last place), by a division (2.5 of them).
inline constexpr double kRounding = 0x1p-24, kUnit = 0x1p-23, kDivision = 2.5 * kUnit;
inline double exp_error(double x) { return (3.0 + 2.0 * (x < 0.0 ? -x : x)) * kUnit; }
/// Of 1 / (1 + exp(-x)), absolutely.
inline double sigmoid_error(double sigmoid, double x) {
    return sigmoid * ((1.0 - sigmoid) * exp_error(x) + kRounding + kDivision);
}
/// Kernel values against the double reference, normalised mean squared error.
inline constexpr double kKernelNmse = 1e-7;
/// The released implementation (float, GPU) against a double renderer: 2.4e-4 m was
/// measured on 256 rays, 7e-4 m here on a ray of 68 m.
inline constexpr double kPeerDepth_m = 1e-3;
inline constexpr double kPeerChannel = 2e-5;

}  // namespace relidar::test
