// SPDX-License-Identifier: Apache-2.0
// Distributes n_new copies to growing surfels in proportion to their weights, by
// systematic sampling. W is the sum of all weights. Copy j belongs to the surfel whose
// interval of the cumulative weights contains (j + 1 - phase / W) W / n_new. Each surfel
// receives its expected number of copies, rounded up or down. The total is exactly n_new,
// and the host can compute the total of any range of surfels without a readback. One
// thread per surfel. Input: weight, cumulative. In place: action. Output: n_rows.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/densify.h"
RELIDAR_PARAMS(AllotParams);

/// Returns the 64-bit number (high, low) divided by `divisor`, rounded down. Uses binary
/// long division. `high` must be less than `divisor`, so that the result fits into 32
/// bits.
uint divide_64_by_32(uint high, uint low, uint divisor) {
    uint quotient = 0u, rest = high;
    for (int bit = 31; bit >= 0; --bit) {
        bool carry = rest >= 0x80000000u;
        rest = rest << 1 | (low >> bit & 1u);
        if (!carry && rest < divisor) continue;
        rest -= divisor;
        quotient |= 1u << bit;
    }
    return quotient;
}

/// Returns how many copies surfels 0 to k receive in total, if `cumulative_weight` is the
/// sum of their weights: floor((cumulative_weight * n_new + phase) / total_weight). All
/// surfels together receive n_new copies. The random `phase` decides between rounding up
/// and down.
uint cumulative_copies(uint cumulative_weight) {
    if (params.total_weight == 0u) return 0u;
    uint high, low, carry;
    umulExtended(cumulative_weight, params.n_new, high, low);
    low = uaddCarry(low, params.phase, carry);
    return divide_64_by_32(high + carry, low, params.total_weight);
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    uint action = params.action.at[i];
    uint before = params.cumulative.at[i];
    uint copies = cumulative_copies(before + params.weight.at[i]) - cumulative_copies(before);
    if (action != RELIDAR_DENSIFY_DROP && copies == 0u) params.action.at[i] = RELIDAR_DENSIFY_KEEP;
    params.n_rows.at[i] = action == RELIDAR_DENSIFY_DROP ? 0u : 1u + copies;
}
