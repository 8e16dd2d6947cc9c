// SPDX-License-Identifier: Apache-2.0
// ReLU and dropout after a normalisation. The dropout mask is the same in every pass over
// one batch. Include this file after shared/refine.h.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#include "../../base/random.glsl"

/// Returns the factor of a normalised value: 0 if it is negative or dropped, otherwise 1
/// / (1 - dropout).
/// @param place  index of the value among the values of the layer
float gate(float normalised, uint place, uint key, float dropout) {
    if (dropout <= 0.0) return normalised > 0.0 ? 1.0 : 0.0;
    float drawn = float(pcg4d(uvec4(key, place, 0u, 0u)).x >> 8u) * (1.0 / 16777216.0);
    return normalised > 0.0 && drawn >= dropout ? 1.0 / (1.0 - dropout) : 0.0;
}

// A workgroup stays within one channel of one image, a "plane", so that it computes the
// plane only once. Integer divisions are slow on a CPU.
uint stretches(uint n_pixels) {
    uint stretch = gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS;
    return (n_pixels + stretch - 1u) / stretch;
}
uint plane_of_workgroup(uint n_pixels) { return workgroup_index() / stretches(n_pixels); }
uint first_pixel(uint n_pixels) {
    return workgroup_index() % stretches(n_pixels) * (gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS) +
           gl_LocalInvocationIndex;
}

/// Returns the index of a slice's plane among the channels of all images of a tensor.
uint plane_in(ImageSlice slice, uint plane, uint n_channels) {
    return plane / n_channels * slice.channels + slice.first + plane % n_channels;
}
#endif
