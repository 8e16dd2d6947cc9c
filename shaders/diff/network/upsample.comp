// SPDX-License-Identifier: Apache-2.0
// Enlarges images by bilinear interpolation. Pixel centres are at half integers. Rows are
// clamped at the borders. Columns wrap around in a circular image. One thread per value.
// Input: from (small). Output: to (large).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(ResampleParams);
#include "resample.glsl"

float interpolate_row(uint image_begin, int row, int left_column, float right_weight) {
    uint row_begin = image_begin + clamp_row(row) * params.small_columns;
    return mix(params.from.values.at[row_begin + wrap_column(left_column)],
               params.from.values.at[row_begin + wrap_column(left_column + 1)], right_weight);
}

void main() {
    uint i = thread_index(), n_large = params.rows * params.columns;
    if (i >= params.n_images * params.n_channels * n_large) return;
    uint x = i % params.columns, y = i / params.columns % params.rows;
    uint channel = i / n_large % params.n_channels, image = i / (n_large * params.n_channels);
    int left, above;
    float share_x, share_y;
    find_neighbours(int(x), params.columns, params.small_columns, left, share_x);
    find_neighbours(int(y), params.rows, params.small_rows, above, share_y);
    uint base = small_index(params.from.channels, params.from.first, image, channel, 0u, 0u);
    params.to.values.at[large_index(params.to.channels, params.to.first, image, channel, y, x)] =
        mix(interpolate_row(base, above, left, share_x), interpolate_row(base, above + 1, left, share_x),
            share_y);
}
