// SPDX-License-Identifier: Apache-2.0
// Functions that all kernels of the radix sort use. Include this file after
// RELIDAR_PARAMS.
#ifndef RELIDAR_INCLUDED_GPU_RADIX_GLSL
#define RELIDAR_INCLUDED_GPU_RADIX_GLSL
RELIDAR_CONSTANT(uint, KEY_WORDS, 1u);

uint n_keys() {
    return !is_null(params.n_keys) ? min(params.n_keys.at[0], params.capacity) : params.capacity;
}
uint n_tiles() { return (n_keys() + RELIDAR_TILE_SIZE - 1u) / RELIDAR_TILE_SIZE; }
uint radix_digit(uint key_index) {
    return params.keys.at[key_index * KEY_WORDS + params.shift / 32u] >> (params.shift % 32u) &
           (RELIDAR_SORT_DIGITS - 1u);
}
#endif
