// SPDX-License-Identifier: Apache-2.0
// Max pooling: computes the maximum of each block of 2 x 2 pixels. Ignores the last row
// or column if the number of rows or columns is odd. One thread per pooled value. Input:
// from (large). Output: to (small).
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
    uint at = large_index(params.from.channels, params.from.first, image, channel, 2u * y, 2u * x);
    float upper = max(params.from.values.at[at], params.from.values.at[at + 1u]);
    float lower =
        max(params.from.values.at[at + params.columns], params.from.values.at[at + params.columns + 1u]);
    params.to.values.at[small_index(params.to.channels, params.to.first, image, channel, y, x)] =
        max(upper, lower);
}
