// SPDX-License-Identifier: Apache-2.0
// Compensated summation (Kahan): the backward pass subtracts long sums from each other,
// so they must keep all digits of a float.
#ifndef RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL
#define RELIDAR_INCLUDED_BASE_COMPENSATED_GLSL

/// sum += x; `lost` carries what rounding took away.
void add_compensated(inout float sum, inout float lost, float x) {
    precise float y = x - lost;
    precise float t = sum + y;
    precise float rest = (t - sum) - y;
    sum = t;
    lost = rest;
}
#endif
