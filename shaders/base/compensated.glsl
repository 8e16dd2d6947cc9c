// SPDX-License-Identifier: Apache-2.0
// Compensated summation (Kahan), which keeps the full float precision in long sums. The
// backward pass needs this precision because it subtracts long sums from each other.
#ifndef RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL
#define RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL

/// Adds x to `sum` with Kahan summation: the rounding error is stored in `lost`, and the
/// next call corrects the sum by it.
void add_with_compensation(inout float sum, inout float lost, float x) {
    precise float y = x - lost;
    precise float t = sum + y;
    precise float rest = (t - sum) - y;
    sum = t;
    lost = rest;
}
#endif
