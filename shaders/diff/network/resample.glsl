// SPDX-License-Identifier: Apache-2.0
// Converts pixel indices between a large and a small image. Define
// RELIDAR_PARAMS(ResampleParams) before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL

/// Returns the index of a value in an array of images.
/// @param n_channels number of channels of each image in the array
/// @param first_channel channel of the array that `channel` = 0 selects
uint large_index(uint n_channels, uint first_channel, uint image, uint channel, uint row, uint column) {
    return ((image * n_channels + first_channel + channel) * params.rows + row) * params.columns + column;
}
uint small_index(uint n_channels, uint first_channel, uint image, uint channel, uint row, uint column) {
    return ((image * n_channels + first_channel + channel) * params.small_rows + row) * params.small_columns +
           column;
}

/// Finds the two pixels of the small image that are nearest to a pixel of the large
/// image, along one axis. Pixel centres are at half integers. Integer arithmetic makes
/// upsampling and its derivative consistent on every device.
/// @param left_pixel output: the left pixel
/// @param right_weight output: interpolation weight of the right pixel
void find_neighbours(int large_pixel, uint n_large, uint n_small, out int left_pixel,
                     out float right_weight) {
    // position in units of half a large pixel
    int unit = 2 * int(n_large), place = (2 * large_pixel + 1) * int(n_small) - int(n_large);
    left_pixel = place < 0 ? -1 : place / unit;
    right_weight = float(place - left_pixel * unit) / float(unit);
}

/// Rows outside the image become the first or last row. So do columns, except that they
/// wrap around in a circular image.
uint clamp_row(int row) { return uint(clamp(row, 0, int(params.small_rows) - 1)); }
uint wrap_column(int column) {
    return params.circular != 0u ? uint(column + int(params.small_columns)) % params.small_columns
                                 : uint(clamp(column, 0, int(params.small_columns) - 1));
}
#endif
