// SPDX-License-Identifier: Apache-2.0
// Compensated summation (Kahan), which keeps the full float precision in long sums. The
// backward pass needs this precision because it subtracts long sums from each other.
#ifndef RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL
#define RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL

/// Adds `value` to `sum` with Kahan summation. The rounding error is stored in
/// `rounding_error`, and the next call subtracts it again.
void kahan_add(inout float sum, inout float rounding_error, float value) {
    precise float y = value - rounding_error;
    precise float t = sum + y;
    precise float rest = (t - sum) - y;
    sum = t;
    rounding_error = rest;
}
#endif
