// SPDX-License-Identifier: Apache-2.0
// Access to the rendered range image and its neighbours, for kernels with
// GeometryLossParams. Include this file after RELIDAR_PARAMS.
#ifndef RELIDAR_INCLUDED_DIFF_LOSS_RANGE_IMAGE_GLSL
#define RELIDAR_INCLUDED_DIFF_LOSS_RANGE_IMAGE_GLSL

const uint kNoPixel = 0xffffffffu;
const float kLeastWeight = 0.5;  // minimum W of a surface; below, the range is not meaningful

DeviceRay ray_of(uint i) { return params.rays.at[params.first_ray + i * params.ray_stride]; }

/// Returns true if the measurement of ray i is known and is a return.
bool returned(uint i) {
    DeviceTarget t = params.targets.at[params.first_ray + i * params.ray_stride];
    return t.weight > 0.0 && t.range_m > 0.0;
}

float image_range(uint i) {
    RenderedRay r = params.rendered.at[i];
    return params.normalised_depth != 0u ? r.depth / r.weight : r.depth;
}

/// Returns true if pixel i has a measured return and renders a surface.
bool is_surface(uint i) {
    return returned(i) && params.rendered.at[i].weight > kLeastWeight && image_range(i) > 0.0;
}

/// Returns the pixel one row or column from pixel i, or kNoPixel if it is outside the
/// image. Columns wrap around if the image is a full sweep.
uint pixel_at(uint i, int row_offset, int column_offset) {
    int columns = int(params.columns);
    int row = int(i / params.columns) + row_offset, column = int(i % params.columns) + column_offset;
    if (params.circular != 0u) column = (column + columns) % columns;
    return row >= 0 && row < int(params.rows) && column >= 0 && column < columns
               ? uint(row * columns + column)
               : kNoPixel;
}
#endif
