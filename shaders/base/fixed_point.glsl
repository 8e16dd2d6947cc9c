// SPDX-License-Identifier: Apache-2.0
// Sums of many threads that do not depend on the order of addition. Uses 64-bit
// fixed-point numbers with steps of 2^-20, in two words of a buffer. The range is +-8e12,
// so that sums do not overflow.
#ifndef RELIDAR_INCLUDED_BASE_FIXED_POINT_GLSL
#define RELIDAR_INCLUDED_BASE_FIXED_POINT_GLSL

layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer FixedWords { uint at[]; };

const float kFixedSteps = 1048576.0, kFixedWord = 4294967296.0;

/// Returns the negative of a two-word number (two's complement).
uvec2 negated(uvec2 x) { return uvec2(~x.x + 1u, ~x.y + uint(x.x == 0u)); }

/// Adds x to sums[entry]. An entry has two words, the low word first. x must be finite
/// and below 1e12.
void add_fixed(Uints sums, uint entry, float x) {
    // Both values are exact, because a float has 24 digits.
    float steps = trunc(abs(x) * kFixedSteps), high = floor(steps / kFixedWord);
    uvec2 amount = uvec2(uint(steps - high * kFixedWord), uint(high));
    if (x < 0.0) amount = negated(amount);
    FixedWords words = FixedWords(uvec2(sums));
    uint before = atomicAdd(words.at[2u * entry], amount.x);
    atomicAdd(words.at[2u * entry + 1u], amount.y + uint(before + amount.x < before));
}

float read_fixed(Uints sums, uint entry) {
    uvec2 sum = uvec2(sums.at[2u * entry], sums.at[2u * entry + 1u]);
    bool negative = (sum.y & 0x80000000u) != 0u;
    if (negative) sum = negated(sum);  // Otherwise the low word would be rounded before it is subtracted.
    float steps = float(sum.y) * kFixedWord + float(sum.x);
    return (negative ? -steps : steps) / kFixedSteps;
}
#endif
