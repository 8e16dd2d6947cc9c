// SPDX-License-Identifier: Apache-2.0
// Random numbers without a state. Each number is a hash of a key and indices, so repeated
// and resumed runs get the same numbers. The hash is PCG4D of Jarzynski and Olano, "Hash
// Functions for GPU Rendering" (2020).
#ifndef RELIDAR_INCLUDED_BASE_RANDOM_GLSL
#define RELIDAR_INCLUDED_BASE_RANDOM_GLSL

// Four pseudorandom words from four key words: two rounds of a linear step and a mix.
uvec4 pcg4d(uvec4 key) {
    key = key * 1664525u + 1013904223u;
    key.x += key.y * key.w;
    key.y += key.z * key.x;
    key.z += key.x * key.y;
    key.w += key.y * key.z;
    key ^= key >> 16u;
    key.x += key.y * key.w;
    key.y += key.z * key.x;
    key.z += key.x * key.y;
    key.w += key.y * key.z;
    return key;
}

/// Returns two independent random numbers with a standard normal distribution (Box and
/// Muller). Equal arguments give equal numbers.
/// @param seed seed of the kernel launch
/// @param element index of the element that needs the numbers
/// @param pair_index index of the pair for this element
vec2 normal_pair(uint seed, uint element, uint pair_index) {
    uvec4 bits = pcg4d(uvec4(seed, element, pair_index, 0u));
    float radius = sqrt(-2.0 * log((float(bits.x >> 8u) + 1.0) * (1.0 / 16777216.0)));
    float angle = 6.283185307179586 * float(bits.y >> 8u) * (1.0 / 16777216.0);
    return radius * vec2(cos(angle), sin(angle));
}
#endif
