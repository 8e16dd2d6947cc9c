// SPDX-License-Identifier: Apache-2.0
// Computes pixel indices for images of two sizes. Include this file after
// RELIDAR_PARAMS(ResampleParams).
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL

uint large_at(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.rows + y) * params.columns + x;
}
uint small_at(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.small_rows + y) * params.small_columns + x;
}

/// Returns the small pixel on the left side of a large pixel, and the interpolation
/// weight of the small pixel to the right. Pixel centres are at half integers. Uses
/// integer arithmetic, so that upsampling and its derivative agree on every device.
void neighbours(int at, uint n_large, uint n_small, out int left, out float share) {
    // in units of half a large entry
    int unit = 2 * int(n_large), place = (2 * at + 1) * int(n_small) - int(n_large);
    left = place < 0 ? -1 : place / unit;
    share = float(place - left * unit) / float(unit);
}

/// Rows outside the image are clamped to the first or last row. Columns outside the image
/// wrap around.
uint row_of(int y) { return uint(clamp(y, 0, int(params.small_rows) - 1)); }
uint column_of(int x) { return uint(x + int(params.small_columns)) % params.small_columns; }
#endif
