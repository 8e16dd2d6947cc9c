// SPDX-License-Identifier: Apache-2.0
// Which columns of a frame a batch has.
#ifndef RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL
#define RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL

/// Column of the frame that the batch's column k is: groups of neighbours, as far apart
/// as every stride-th column would be.
uint frame_column(uint k, uint first_column, uint column_stride, uint n_columns_of_frame) {
    uint within = k % RELIDAR_COLUMN_GROUP;
    return (first_column + (k - within) * column_stride + within) % n_columns_of_frame;
}
#endif
