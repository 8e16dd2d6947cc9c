// SPDX-License-Identifier: Apache-2.0
// Normalised, ReLU, dropout: to = dropout(max(scale x + shift, 0)), one thread a value.
// Input: from, scale_shift. Output: to. Floor: 8 B a value.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/refine.h"
#include "norm.glsl"
RELIDAR_PARAMS(NormParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_images * params.n_channels * params.n_pixels) return;
    vec2 affine = params.scale_shift.at[i / params.n_pixels % params.n_channels];
    float x = params.from.values.at[place_in(params.from.channels, params.from.first, i, params.n_channels, params.n_pixels)];
    float normalised = affine.x * x + affine.y;
    params.to.values.at[place_in(params.to.channels, params.to.first, i, params.n_channels, params.n_pixels)] =
        normalised * gate(normalised, i, params.dropout_key, params.dropout);
}
