// SPDX-License-Identifier: Apache-2.0
// Enlarges images by bilinear interpolation. Pixel centres are at half integers. Rows are
// clamped at the borders, and columns wrap around. One thread per value. Input: from
// (small). Output: to (large).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(ResampleParams);
#include "resample.glsl"

float line_at(uint base, int y, int x, float share) {
    uint row = base + row_of(y) * params.small_columns;
    return mix(params.from.values.at[row + column_of(x)], params.from.values.at[row + column_of(x + 1)],
               share);
}

void main() {
    uint i = thread_index(), n_large = params.rows * params.columns;
    if (i >= params.n_images * params.n_channels * n_large) return;
    uint x = i % params.columns, y = i / params.columns % params.rows;
    uint channel = i / n_large % params.n_channels, image = i / (n_large * params.n_channels);
    int left, above;
    float share_x, share_y;
    neighbours(int(x), params.columns, params.small_columns, left, share_x);
    neighbours(int(y), params.rows, params.small_rows, above, share_y);
    uint base = small_at(params.from.channels, params.from.first, image, channel, 0u, 0u);
    params.to.values.at[large_at(params.to.channels, params.to.first, image, channel, y, x)] =
        mix(line_at(base, above, left, share_x), line_at(base, above + 1, left, share_x), share_y);
}
