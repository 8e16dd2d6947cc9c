// SPDX-License-Identifier: Apache-2.0
// Defines the window of the structural similarity: a Gaussian of 1.5 pixels in 11 x 11
// pixels. Only known pixels with a return have a weight, and the weights are normalised
// over these pixels. Therefore pixels without a return, unknown pixels and rows outside
// the image have no influence. Columns wrap around if the image is a full sweep.
#ifndef RELIDAR_INCLUDED_DIFF_LOSS_SSIM_GLSL
#define RELIDAR_INCLUDED_DIFF_LOSS_SSIM_GLSL

const int kSsimRadius = 5;
const uint kNoPixel = 0xffffffffu;
// exp(-d^2 / 4.5)
const float kGaussianByDistance[6] =
    float[](1.0, 0.80073740, 0.41111229, 0.13533528, 0.028565500, 0.0038659201);

/// Returns the index of the pixel at an offset from pixel `index`. Returns kNoPixel if
/// this pixel would be outside the image.
uint window_pixel(uint index, int row_offset, int column_offset) {
    int columns = int(params.columns);
    int row = int(index / params.columns) + row_offset, column = int(index % params.columns) + column_offset;
    if (params.circular != 0u && columns > 2 * kSsimRadius) column = (column + columns) % columns;
    return row >= 0 && row < int(params.rows) && column >= 0 && column < columns
               ? uint(row * columns + column)
               : kNoPixel;
}

float window_weight(int row_offset, int column_offset) {
    return kGaussianByDistance[abs(row_offset)] * kGaussianByDistance[abs(column_offset)];
}

DeviceTarget load_target(uint index) {
    return params.targets.at[params.first_ray + index * params.ray_stride];
}
bool has_return(DeviceTarget target) { return target.weight > 0.0 && target.range_m > 0.0; }
#endif
