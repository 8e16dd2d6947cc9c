// SPDX-License-Identifier: Apache-2.0
// Hands n_new copies out to growing surfels in proportion to their weights, by systematic
// sampling: copy j belongs to the surfel whose interval of the cumulative weights holds
// (j + 1 - phase / W) W / n_new. Exactly n_new are handed out, a surfel gets its expected
// number rounded up or down, and the host knows the sum over any range without asking.
// One thread a surfel. Input: weight, cumulative. In place: action. Output: n_rows.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(AllotParams);

/// high * 2^32 + low over d, rounded down, digit by digit; high is below d, so that it
/// fits.
uint divided(uint high, uint low, uint d) {
    uint quotient = 0u, rest = high;
    for (int bit = 31; bit >= 0; --bit) {
        bool carry = rest >= 0x80000000u;
        rest = rest << 1 | (low >> bit & 1u);
        if (!carry && rest < d) continue;
        rest -= d;
        quotient |= 1u << bit;
    }
    return quotient;
}

/// (weight * n_new + phase) / total_weight: the product has 64 bits.
uint allotted_before(uint weight) {
    if (params.total_weight == 0u) return 0u;
    uint high, low, carry;
    umulExtended(weight, params.n_new, high, low);
    low = uaddCarry(low, params.phase, carry);
    return divided(high + carry, low, params.total_weight);
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint action = params.action.at[i];
    uint before = params.cumulative.at[i];
    uint copies = allotted_before(before + params.weight.at[i]) - allotted_before(before);
    if (action != RELIDAR_DENSIFY_DROP && copies == 0u) params.action.at[i] = RELIDAR_DENSIFY_KEEP;
    params.n_rows.at[i] = action == RELIDAR_DENSIFY_DROP ? 0u : 1u + copies;
}
