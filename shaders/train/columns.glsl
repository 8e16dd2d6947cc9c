// SPDX-License-Identifier: Apache-2.0
// Maps the columns of a batch to columns of the frame.
#ifndef RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL
#define RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL

/// Returns the frame column of the batch's column k. The batch has groups of neighbouring
/// columns; the groups are as far apart as every stride-th column would be.
uint frame_column(uint k, uint first_column, uint column_stride, uint n_columns_of_frame) {
    uint within = k % RELIDAR_COLUMN_GROUP;
    return (first_column + (k - within) * column_stride + within) % n_columns_of_frame;
}
#endif
