// SPDX-License-Identifier: Apache-2.0
// Applies ReLU and dropout after a normalisation. The forward and backward passes of one
// batch drop the same values, because the random numbers depend only on a key and the
// index. Include this file after shared/refine.h.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_NORM_GLSL
#include "../../base/random.glsl"

/// Returns the factor that ReLU and dropout apply to a normalised value. It is 0 for a
/// negative or dropped value, otherwise 1 / (1 - dropout).
/// @param value_index index of the value in the layer
float relu_dropout(float normalised, uint value_index, uint random_key, float dropout_share) {
    if (dropout_share <= 0.0) return normalised > 0.0 ? 1.0 : 0.0;
    float drawn = float(pcg4d(uvec4(random_key, value_index, 0u, 0u)).x >> 8u) * (1.0 / 16777216.0);
    return normalised > 0.0 && drawn >= dropout_share ? 1.0 / (1.0 - dropout_share) : 0.0;
}

// Returns the number of workgroups that process one channel of an image. Each workgroup
// processes only one channel, so that it computes the channel index only once. Integer
// divisions are slow on a CPU.
uint workgroups_per_plane(uint pixels_per_plane) {
    uint stretch = gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS;
    return (pixels_per_plane + stretch - 1u) / stretch;
}
uint workgroup_plane(uint pixels_per_plane) {
    return workgroup_index() / workgroups_per_plane(pixels_per_plane);
}
uint thread_pixel(uint pixels_per_plane) {
    return workgroup_index() % workgroups_per_plane(pixels_per_plane) *
               (gl_WorkGroupSize.x * RELIDAR_NORM_PIXELS) +
           gl_LocalInvocationIndex;
}

/// A plane is one channel of one image. Planes are numbered image by image. Converts the
/// number of a plane in a slice (some channels of a tensor) to its number in the full
/// tensor.
/// @param n_channels number of channels of the slice
uint plane_index(ImageSlice slice, uint plane, uint n_channels) {
    return plane / n_channels * slice.channels + slice.first + plane % n_channels;
}
#endif
