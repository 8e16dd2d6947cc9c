// SPDX-License-Identifier: Apache-2.0
// What the kernels of a radix pass share. A workgroup has as many threads as a digit has values.
#ifndef RELIDAR_INCLUDED_ACCEL_BVH_SORT_GLSL
#define RELIDAR_INCLUDED_ACCEL_BVH_SORT_GLSL
uint digit_of(uvec2 key, uint shift) { return (shift < 32u ? key.x >> shift : key.y >> (shift - 32u)) & (RELIDAR_SORT_DIGITS - 1u); }
#endif
