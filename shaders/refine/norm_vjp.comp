// SPDX-License-Identifier: Apache-2.0
// Derivative of normalisation, ReLU and dropout by what was normalised, one thread a value:
//   d_from = scale (g - mean(g) - x^ mean(g x^)),   g = gate * d_to,   x^ = (x - mean) / deviation
// Input: from, d_to, d_beta_gamma, scale_shift, moments. Output or accumulated: d_from.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_PARAMS(NormVjpParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_images * params.n_channels * params.n_pixels) return;
    uint channel = i / params.n_pixels % params.n_channels;
    vec2 affine = params.scale_shift.at[channel], moments = params.moments.at[channel];
    float x = params.from.values.at[place_in(params.from.channels, params.from.first, i, params.n_channels, params.n_pixels)];
    float d = params.d_to.values.at[place_in(params.d_to.channels, params.d_to.first, i, params.n_channels, params.n_pixels)];
    float g = d * gate(affine.x * x + affine.y, i, params.dropout_key, params.dropout);
    vec2 mean = params.d_beta_gamma.at[channel] / float(params.n_images * params.n_pixels);
    uint to = place_in(params.d_from.channels, params.d_from.first, i, params.n_channels, params.n_pixels);
    float d_x = affine.x * (g - mean.x - (x - moments.x) * moments.y * mean.y);
    if (params.accumulate != 0u) d_x += params.d_from.values.at[to];
    params.d_from.values.at[to] = d_x;
}
