// SPDX-License-Identifier: Apache-2.0
// Computes the derivative of normalisation, ReLU and dropout with respect to their input.
// One thread per RELIDAR_NORM_PIXELS values.
//   d_from = scale (g - mean(g) - x^ mean(g x^)),
//   g = gate * d_to,   x^ = (x - mean) / deviation
//
// Input: from, d_to, d_beta_gamma, scale_shift, moments. Output or accumulated: d_from.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_PARAMS(NormVjpParams);

void main() {
    uint plane = workgroup_plane(params.n_pixels);
    if (plane >= params.n_images * params.n_channels) return;
    uint channel = plane % params.n_channels, first = thread_pixel(params.n_pixels);
    vec2 affine = params.scale_shift.at[channel], moments = params.moments.at[channel];
    // mean(g) and mean(g x^): the gradients of beta and gamma per pixel of the batch.
    vec2 mean = params.d_beta_gamma.at[channel] * (1.0 / float(params.n_images * params.n_pixels));
    uint from = plane_index(params.from, plane, params.n_channels) * params.n_pixels;
    uint d_to = plane_index(params.d_to, plane, params.n_channels) * params.n_pixels;
    uint to = plane_index(params.d_from, plane, params.n_channels) * params.n_pixels;
    for (uint k = 0u; k < RELIDAR_NORM_PIXELS; ++k) {
        uint pixel = first + k * gl_WorkGroupSize.x;
        if (pixel >= params.n_pixels) return;
        float x = params.from.values.at[from + pixel];
        uint place = plane * params.n_pixels + pixel;
        float g = params.d_to.values.at[d_to + pixel] *
                  relu_dropout(affine.x * x + affine.y, place, params.dropout_key, params.dropout);
        float d_x = affine.x * (g - mean.x - (x - moments.x) * moments.y * mean.y);
        if (params.accumulate != 0u) d_x += params.d_from.values.at[to + pixel];
        params.d_from.values.at[to + pixel] = d_x;
    }
}
