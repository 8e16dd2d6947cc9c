// SPDX-License-Identifier: Apache-2.0
// Derivative of bilinear upsampling. Each pixel of the small image sums the gradients of
// all large pixels that were interpolated from it. One thread per value. Input: from
// (large gradients). Output: to (small gradients).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_PARAMS(ResampleParams);
#include "resample.glsl"

/// Finds all pixels of the large image to which a pixel of the small image contributes,
/// along one axis. The range may be slightly too large.
/// @param first output: first large pixel
/// @param count output: number of large pixels
void find_candidate_pixels(uint position, uint n_large, uint n_small, out int first, out int count) {
    float step = float(n_large) / float(n_small);
    first = int(floor((float(position) - 0.5) * step - 0.5)) - 1;
    count = min(int(ceil(2.0 * step)) + 4, int(n_large));
}

float compute_row_weight(int y, uint row) {
    if (y < 0 || y >= int(params.rows)) return 0.0;
    int above;
    float share;
    find_neighbour_pixels(y, params.rows, params.small_rows, above, share);
    return (clamp_row(above) == row ? 1.0 - share : 0.0) + (clamp_row(above + 1) == row ? share : 0.0);
}

float compute_column_weight(int value, uint column) {
    int left;
    float share;
    find_neighbour_pixels(value, params.columns, params.small_columns, left, share);
    return (wrap_column(left) == column ? 1.0 - share : 0.0) +
           (wrap_column(left + 1) == column ? share : 0.0);
}

void main() {
    uint i = get_thread_index(), n_small = params.small_rows * params.small_columns;
    if (i >= params.n_images * params.n_channels * n_small) return;
    uint column = i % params.small_columns, row = i / params.small_columns % params.small_rows;
    uint channel = i / n_small % params.n_channels, image = i / (n_small * params.n_channels);
    int first_x, first_y, n_x, n_y;
    find_candidate_pixels(column, params.columns, params.small_columns, first_x, n_x);
    find_candidate_pixels(row, params.rows, params.small_rows, first_y, n_y);
    // Moves the range of rows into the image, because only columns wrap around.
    first_y = clamp(first_y, 0, int(params.rows) - n_y);
    float sum = 0.0;
    for (int y = first_y; y < first_y + n_y; ++y) {
        float weight_y = compute_row_weight(y, row);
        if (weight_y == 0.0) continue;
        for (int k = 0; k < n_x; ++k) {
            int x = (first_x + k + 2 * int(params.columns)) % int(params.columns);
            float weight = weight_y * compute_column_weight(x, column);
            if (weight == 0.0) continue;
            uint at =
                load_large_pixel(params.from.channels, params.from.first, image, channel, uint(y), uint(x));
            sum += weight * params.from.values.at[at];
        }
    }
    params.to.values.at[load_small_pixel(params.to.channels, params.to.first, image, channel, row, column)] =
        sum;
}
