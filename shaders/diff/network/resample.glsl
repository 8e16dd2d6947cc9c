// SPDX-License-Identifier: Apache-2.0
// Places of pixels in images of two sizes. Include after RELIDAR_PARAMS(ResampleParams).
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_RESAMPLE_GLSL

uint large_at(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.rows + y) * params.columns + x;
}
uint small_at(uint channels, uint first, uint image, uint channel, uint y, uint x) {
    return ((image * channels + first + channel) * params.small_rows + y) * params.small_columns + x;
}

/// Between which two of n_small entries one of n_large lies, centres at half steps, and
/// the share of the second. In whole numbers, so that upsampling and its derivative agree
/// on it whatever a device's division does.
void neighbours(int at, uint n_large, uint n_small, out int left, out float share) {
    // in halves of a large entry
    int whole = 2 * int(n_large), place = (2 * at + 1) * int(n_small) - int(n_large);
    left = place < 0 ? -1 : place / whole;
    share = float(place - left * whole) / float(whole);
}

/// Beyond the ends of rows lies the last one; columns are a ring.
uint row_of(int y) { return uint(clamp(y, 0, int(params.small_rows) - 1)); }
uint column_of(int x) { return uint(x + int(params.small_columns)) % params.small_columns; }
#endif
