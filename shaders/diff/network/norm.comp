// SPDX-License-Identifier: Apache-2.0
// Applies a normalisation layer with ReLU and dropout: to = dropout(max(scale x + shift,
// 0)). A workgroup processes a range of pixels of one channel. Input: from, scale_shift.
// Output: to. Memory traffic: at least 8 B per value.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_PARAMS(NormParams);

void main() {
    uint plane = workgroup_plane(params.n_pixels);
    if (plane >= params.n_images * params.n_channels) return;
    vec2 affine = params.scale_shift.at[plane % params.n_channels];
    uint from = plane_index(params.from, plane, params.n_channels) * params.n_pixels;
    uint to = plane_index(params.to, plane, params.n_channels) * params.n_pixels,
         first = thread_pixel(params.n_pixels);
    for (uint k = 0u; k < RELIDAR_NORM_PIXELS; ++k) {
        uint pixel = first + k * gl_WorkGroupSize.x;
        if (pixel >= params.n_pixels) return;
        float normalised = affine.x * params.from.values.at[from + pixel] + affine.y;
        float passes =
            relu_dropout(normalised, plane * params.n_pixels + pixel, params.dropout_key, params.dropout);
        params.to.values.at[to + pixel] = normalised * passes;
    }
}
