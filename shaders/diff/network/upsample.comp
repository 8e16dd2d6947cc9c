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

float interpolate_line(uint base, int y, int x, float share) {
    uint row = base + clamp_row(y) * params.small_columns;
    return mix(params.from.values.at[row + wrap_column(x)], params.from.values.at[row + wrap_column(x + 1)],
               share);
}

void main() {
    uint i = get_thread_index(), n_large = params.rows * params.columns;
    if (i >= params.n_images * params.n_channels * n_large) return;
    uint x = i % params.columns, y = i / params.columns % params.rows;
    uint channel = i / n_large % params.n_channels, image = i / (n_large * params.n_channels);
    int left, above;
    float share_x, share_y;
    find_neighbour_pixels(int(x), params.columns, params.small_columns, left, share_x);
    find_neighbour_pixels(int(y), params.rows, params.small_rows, above, share_y);
    uint base = load_small_pixel(params.from.channels, params.from.first, image, channel, 0u, 0u);
    params.to.values.at[load_large_pixel(params.to.channels, params.to.first, image, channel, y, x)] =
        mix(interpolate_line(base, above, left, share_x), interpolate_line(base, above + 1, left, share_x),
            share_y);
}
