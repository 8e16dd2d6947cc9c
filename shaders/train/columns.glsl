// SPDX-License-Identifier: Apache-2.0
// Computes which columns of a frame's range image form a training batch.
#ifndef RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL
#define RELIDAR_INCLUDED_TRAIN_COLUMNS_GLSL

/// Returns the column of the frame that becomes column `index` of the batch. A batch
/// consists of groups of RELIDAR_COLUMN_GROUP neighbouring columns. Group k starts at the
/// frame's column first_column + k * column_stride * RELIDAR_COLUMN_GROUP. Columns wrap
/// around at the end of the frame.
uint frame_column(uint index, uint first_column, uint column_stride, uint n_columns_of_frame) {
    uint within = index % RELIDAR_COLUMN_GROUP;
    return (first_column + (index - within) * column_stride + within) % n_columns_of_frame;
}
#endif
