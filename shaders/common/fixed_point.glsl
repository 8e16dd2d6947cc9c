// SPDX-License-Identifier: Apache-2.0
// Sums of many threads that come out the same in any order: fixed point of 64 bits, 2^-20 a step, in two words of a buffer. The range
// is +-8e12, so sums do not overflow.
#ifndef RELIDAR_INCLUDED_COMMON_FIXED_POINT_GLSL
#define RELIDAR_INCLUDED_COMMON_FIXED_POINT_GLSL

layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer FixedWord { uint value; };

const float kFixedSteps = 1048576.0;

/// sums[entry] += x; an entry is two words. x is finite and below 1e12.
void add_fixed(Uints sums, uint entry, float x) {
    int64_t amount = int64_t(x * kFixedSteps);
    uint low = uint(uint64_t(amount)), high = uint(uint64_t(amount) >> 32);
    uint64_t address = uint64_t(sums) + uint64_t(entry) * 8ul;
    FixedWord low_word = FixedWord(address), high_word = FixedWord(address + 4ul);
    uint before = atomicAdd(low_word.value, low);
    atomicAdd(high_word.value, high + (before + low < before ? 1u : 0u));
}

float read_fixed(Uints sums, uint entry) {
    return float(int64_t(uint64_t(sums.at[2u * entry]) | uint64_t(sums.at[2u * entry + 1u]) << 32)) / kFixedSteps;
}
#endif
