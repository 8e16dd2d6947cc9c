// SPDX-License-Identifier: Apache-2.0
// Compensated summation (Kahan). Needed because the backward pass subtracts long sums
// from each other, so the sums must keep the full float precision.
#ifndef RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL
#define RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL

/// Adds x to sum. `lost` carries the rounding error to the next call.
void add_compensated(inout float sum, inout float lost, float x) {
    precise float y = x - lost;
    precise float t = sum + y;
    precise float rest = (t - sum) - y;
    sum = t;
    lost = rest;
}
#endif
