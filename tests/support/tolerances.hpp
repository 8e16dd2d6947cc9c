// SPDX-License-Identifier: Apache-2.0
// Defines the tolerances of all tests, each with its reason (docs/architecture.md section
// 9).
#pragma once

namespace relidar::test {

/// Step sizes of central differences of the double reference. For lengths (surfels of
/// about 0.2 m), the truncation error h^2 f'''/6 and the cancellation error eps L / h
/// balance near h = 1e-5. Angles move surfels at 10 m ten times as far, so their step is
/// smaller. Logits and SH coefficients change the image almost linearly, so their step is
/// larger.
inline constexpr double kDifferenceStep = 1e-5;
inline constexpr double kAngleStep = 1e-6;
inline constexpr double kLogitStep = 1e-4;
/// Tolerance between the reference's backward pass and central differences, relative to
/// the row's norm.
inline constexpr double kReferenceGradient = 1e-6;
/// Rows below this share of the largest row in their group are compared relative to the
/// share. Their differences have no significant digits, because the cancellation error is
/// absolute (about 1e-10).
inline constexpr double kSmallRow = 3e-3;
/// Tolerance of a kernel against the reference's backward pass, relative to the row's
/// norm. A ray has some tens of hits in single precision.
inline constexpr double kKernelGradient = 1e-4;
/// Errors that Vulkan allows in single precision, relative to the result. They are a
/// rounding, exp (3 + 2 |x| units in the last place), and a division (2.5 units).
inline constexpr double kRounding = 0x1p-24, kUnit = 0x1p-23, kDivision = 2.5 * kUnit;
inline double compute_exp_error(double value) { return (3.0 + 2.0 * (value < 0.0 ? -value : value)) * kUnit; }
/// Returns the absolute error bound of 1 / (1 + exp(-x)).
inline double compute_sigmoid_error(double sigmoid, double value) {
    return sigmoid * ((1.0 - sigmoid) * compute_exp_error(value) + kRounding + kDivision);
}
/// Tolerance of kernel values against the double reference: normalised mean squared
/// error.
inline constexpr double kKernelNmse = 1e-7;

}  // namespace relidar::test
