// SPDX-License-Identifier: Apache-2.0
// Sums over many threads whose result does not depend on the order of addition. Each sum
// is a 64-bit fixed-point number with steps of 2^-20, stored as two 32-bit words. Its
// range is +-8e12.
#ifndef RELIDAR_INCLUDED_BASE_FIXED_POINT_GLSL
#define RELIDAR_INCLUDED_BASE_FIXED_POINT_GLSL

layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer FixedWords { uint at[]; };

const float kFixedSteps = 1048576.0, kFixedWord = 4294967296.0;

/// Returns -value for a 64-bit number of two words (two's complement).
uvec2 negate_64_bit(uvec2 words) { return uvec2(~words.x + 1u, ~words.y + uint(words.x == 0u)); }

/// Adds `value` to a sum. The sum is a fixed-point number of two words in `sums`, the low
/// word first. `value` must be finite, with an absolute value below 1e12.
void add_fixed(Uints sums, uint sum_index, float value) {
    // Converts |value| to a fixed-point number with a low and a high word. This is exact,
    // because a float has only 24 significant bits.
    float steps = trunc(abs(value) * kFixedSteps), high = floor(steps / kFixedWord);
    uvec2 amount = uvec2(uint(steps - high * kFixedWord), uint(high));
    if (value < 0.0) amount = negate_64_bit(amount);
    FixedWords words = FixedWords(uvec2(sums));
    // If the low word overflows, exactly this thread sees it and adds the carry, so the
    // sum is right in any order.
    uint before = atomicAdd(words.at[2u * sum_index], amount.x);
    atomicAdd(words.at[2u * sum_index + 1u], amount.y + uint(before + amount.x < before));
}

/// Returns a sum of add_fixed() as a float.
float read_fixed(Uints sums, uint sum_index) {
    uvec2 sum = uvec2(sums.at[2u * sum_index], sums.at[2u * sum_index + 1u]);
    bool negative = (sum.y & 0x80000000u) != 0u;
    // In two's complement, the words of a small negative number are large. Their
    // conversion to float would lose digits. Therefore the absolute value is converted.
    if (negative) sum = negate_64_bit(sum);
    float steps = float(sum.y) * kFixedWord + float(sum.x);
    return (negative ? -steps : steps) / kFixedSteps;
}
#endif
