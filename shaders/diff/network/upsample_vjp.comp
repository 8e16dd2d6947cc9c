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
/// @param first_large_pixel output: first large pixel
/// @param count output: number of large pixels
void find_large_pixels(uint small_pixel, uint n_large, uint n_small, out int first_large_pixel,
                       out int count) {
    float step = float(n_large) / float(n_small);
    first_large_pixel = int(floor((float(small_pixel) - 0.5) * step - 0.5)) - 1;
    count = min(int(ceil(2.0 * step)) + 4, int(n_large));
}

/// Returns the weight of a row of the small image in a row of the large image.
float small_row_weight(int large_row, uint small_row) {
    if (large_row < 0 || large_row >= int(params.rows)) return 0.0;
    int above;
    float lower_weight;
    find_neighbours(large_row, params.rows, params.small_rows, above, lower_weight);
    return (clamp_row(above) == small_row ? 1.0 - lower_weight : 0.0) +
           (clamp_row(above + 1) == small_row ? lower_weight : 0.0);
}

/// Returns the weight of a column of the small image in a column of the large image.
float small_column_weight(int large_column, uint small_column) {
    int left;
    float right_weight;
    find_neighbours(large_column, params.columns, params.small_columns, left, right_weight);
    return (wrap_column(left) == small_column ? 1.0 - right_weight : 0.0) +
           (wrap_column(left + 1) == small_column ? right_weight : 0.0);
}

void main() {
    uint i = thread_index(), n_small = params.small_rows * params.small_columns;
    if (i >= params.n_images * params.n_channels * n_small) return;
    uint column = i % params.small_columns, row = i / params.small_columns % params.small_rows;
    uint channel = i / n_small % params.n_channels, image = i / (n_small * params.n_channels);
    int first_x, first_y, n_x, n_y;
    find_large_pixels(column, params.columns, params.small_columns, first_x, n_x);
    find_large_pixels(row, params.rows, params.small_rows, first_y, n_y);
    // Moves the range of rows into the image, because only columns can wrap around.
    first_y = clamp(first_y, 0, int(params.rows) - n_y);
    float sum = 0.0;
    for (int y = first_y; y < first_y + n_y; ++y) {
        float weight_y = small_row_weight(y, row);
        if (weight_y == 0.0) continue;
        for (int k = 0; k < n_x; ++k) {
            // Columns wrap around. n_x <= columns, so no column is added twice.
            int x = (first_x + k + 2 * int(params.columns)) % int(params.columns);
            float weight = weight_y * small_column_weight(x, column);
            if (weight == 0.0) continue;
            uint at = large_index(params.from.channels, params.from.first, image, channel, uint(y), uint(x));
            sum += weight * params.from.values.at[at];
        }
    }
    params.to.values.at[small_index(params.to.channels, params.to.first, image, channel, row, column)] = sum;
}
