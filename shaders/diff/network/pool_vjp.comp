// SPDX-License-Identifier: Apache-2.0
// Derivative of max pooling over 2 x 2 pixels. Adds the gradient of each pooled value to
// the pixel with the maximum. If several pixels have the maximum, uses the first. One
// thread per pooled value. Input: from (small gradients), pooled (large values). In
// place: to (large gradients).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(ResampleParams);
#include "resample.glsl"

void main() {
    uint i = thread_index(), n_small = params.small_rows * params.small_columns;
    if (i >= params.n_images * params.n_channels * n_small) return;
    uint x = i % params.small_columns, y = i / params.small_columns % params.small_rows;
    uint channel = i / n_small % params.n_channels, image = i / (n_small * params.n_channels);
    uint first = large_index(params.pooled.channels, params.pooled.first, image, channel, 2u * y, 2u * x),
         largest = 0u;
    float value = params.pooled.values.at[first];
    for (uint k = 1u; k < 4u; ++k) {
        // Offset of pixel (k / 2, k % 2) of the block from its first pixel.
        uint off = k % 2u + k / 2u * params.columns;
        float v = params.pooled.values.at[first + off];
        largest = v > value ? off : largest;
        value = max(value, v);
    }
    uint to = large_index(params.to.channels, params.to.first, image, channel, 2u * y, 2u * x) + largest;
    float d =
        params.from.values.at[small_index(params.from.channels, params.from.first, image, channel, y, x)];
    params.to.values.at[to] = params.to.values.at[to] + d;
}
