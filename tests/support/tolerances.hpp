// SPDX-License-Identifier: Apache-2.0
// Tolerances of the test suite, each with its reason (docs/architecture.md section 9).
#pragma once

namespace relidar::test {

/// Step sizes of the central differences of the double reference. The truncation error
/// h^2 f'''/6 and the cancellation error eps L / h balance near h = 1e-5 for lengths
/// (surfels of about 0.2 m). Angles need a smaller step, because a surfel 10 m away moves
/// ten times as far. Logits and SH coefficients can use a larger step, because the image
/// is nearly linear in them.
inline constexpr double kDifferenceStep = 1e-5;
inline constexpr double kAngleStep = 1e-6;
inline constexpr double kLogitStep = 1e-4;
/// Largest error of the reference gradient against central differences, relative to the
/// norm of a row.
inline constexpr double kReferenceGradient = 1e-6;
/// Rows below this share of the largest row of their group are compared with that share
/// instead of their norm. Central differences of smaller rows have no valid digits,
/// because the cancellation error is absolute (about 1e-10).
inline constexpr double kSmallRow = 3e-3;
/// Largest error of a kernel's gradient against the double reference, relative to the
/// norm of a row. A ray sums some tens of hits in single precision.
inline constexpr double kKernelGradient = 1e-4;
/// Relative errors that Vulkan allows in single precision: one rounding, exp (3 + 2 |x|
/// units in the last place), and a division (2.5 units).
inline constexpr double kRounding = 0x1p-24, kUnit = 0x1p-23, kDivision = 2.5 * kUnit;
inline double exp_error(double x) { return (3.0 + 2.0 * (x < 0.0 ? -x : x)) * kUnit; }
/// Returns the absolute error that Vulkan allows for 1 / (1 + exp(-x)).
inline double sigmoid_error(double sigmoid, double x) {
    return sigmoid * ((1.0 - sigmoid) * exp_error(x) + kRounding + kDivision);
}
/// Largest normalised mean squared error of kernel values against the double reference.
inline constexpr double kKernelNmse = 1e-7;
/// Largest difference between the released implementation (float, GPU) and a double
/// renderer. The measured difference is 2.4e-4 m for 256 rays, and 7e-4 m for a ray of 68
/// m.
inline constexpr double kPeerDepth_m = 1e-3;
inline constexpr double kPeerChannel = 2e-5;

}  // namespace relidar::test
