// SPDX-License-Identifier: Apache-2.0
// What lies behind a normalisation: ReLU and dropout, which is the same for every pass
// over the same batch. Include after shared/refine.h.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#include "../../base/random.glsl"

/// Factor by which a normalised value goes on: 0 where it is negative or dropped, else 1
/// / (1 - dropout).
/// @param place of the value among those of the layer
float gate(float normalised, uint place, uint key, float dropout) {
    if (dropout <= 0.0) return normalised > 0.0 ? 1.0 : 0.0;
    float drawn = float(pcg4d(uvec4(key, place, 0u, 0u)).x >> 8u) * (1.0 / 16777216.0);
    return normalised > 0.0 && drawn >= dropout ? 1.0 / (1.0 - dropout) : 0.0;
}

// Divisions of integers are dear on a CPU: a workgroup stays within one channel of one
// image, a "plane", and finds it once.
uint stretches(uint n_pixels) {
    uint stretch = gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS;
    return (n_pixels + stretch - 1u) / stretch;
}
uint plane_of_workgroup(uint n_pixels) { return workgroup_index() / stretches(n_pixels); }
uint first_pixel(uint n_pixels) {
    return workgroup_index() % stretches(n_pixels) * (gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS) +
           gl_LocalInvocationIndex;
}

/// Number among the channels of all of a tensor's images, of a plane of a slice.
uint plane_in(ImageSlice slice, uint plane, uint n_channels) {
    return plane / n_channels * slice.channels + slice.first + plane % n_channels;
}
#endif
