// SPDX-License-Identifier: Apache-2.0
// Converts pixel indices between a large and a small image. Define
// RELIDAR_PARAMS(ResampleParams) before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL

uint load_large_pixel(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.rows + y) * params.columns + x;
}
uint load_small_pixel(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.small_rows + y) * params.small_columns + x;
}

/// Finds the two pixels of the small image that are nearest to a pixel of the large
/// image, along one axis. Pixel centres are at half integers. Integer arithmetic makes
/// upsampling and its derivative consistent on every device.
/// @param left output: the left pixel
/// @param share output: interpolation weight of the right pixel
void find_neighbour_pixels(int position, uint n_large, uint n_small, out int left, out float share) {
    // position in units of half a large pixel
    int unit = 2 * int(n_large), place = (2 * position + 1) * int(n_small) - int(n_large);
    left = place < 0 ? -1 : place / unit;
    share = float(place - left * unit) / float(unit);
}

/// Rows outside the image become the first or last row. Columns wrap around.
uint clamp_row(int row) { return uint(clamp(row, 0, int(params.small_rows) - 1)); }
uint wrap_column(int column) { return uint(column + int(params.small_columns)) % params.small_columns; }
#endif
