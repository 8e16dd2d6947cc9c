// SPDX-License-Identifier: Apache-2.0
// What lies behind a normalisation: ReLU and dropout, which is the same for every pass over the same batch. Include after shared/refine.h.
#ifndef RELIDAR_INCLUDED_REFINE_NORM_GLSL
#define RELIDAR_INCLUDED_REFINE_NORM_GLSL
#include "../common/random.glsl"

/// Factor by which a normalised value goes on: 0 where it is negative or dropped, else 1 / (1 - dropout).
/// @param place of the value among those of the layer
float gate(float normalised, uint place, uint key, float dropout) {
    if (dropout <= 0.0) return normalised > 0.0 ? 1.0 : 0.0;
    float drawn = float(pcg4d(uvec4(key, place, 0u, 0u)).x >> 8u) * (1.0 / 16777216.0);
    return normalised > 0.0 && drawn >= dropout ? 1.0 / (1.0 - dropout) : 0.0;
}

/// Where a value of a slice lies. @param at  [n_images, n_channels, n_pixels] among the slice's own
uint place_in(uint channels, uint first, uint at, uint n_channels, uint n_pixels) {
    uint image = at / (n_channels * n_pixels);
    return at + (image * (channels - n_channels) + first) * n_pixels;
}
#endif
