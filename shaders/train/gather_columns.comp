// SPDX-License-Identifier: Apache-2.0
// Copies selected columns of a frame next to each other, so that later kernels can read
// the batch as an image. One thread per ray of the batch. Input: rays, targets. Output:
// batch_rays, batch_targets.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/train.h"
#include "columns.glsl"
RELIDAR_PARAMS(GatherColumnsParams);

void main() {
    uint k = thread_index();
    if (k >= params.rows * params.n_columns) return;
    uint column =
        frame_column(k % params.n_columns, params.first_column, params.column_stride, params.columns);
    uint i = k / params.n_columns * params.columns + column;
    params.batch_rays.at[k] = params.rays.at[i];
    params.batch_targets.at[k] = params.targets.at[i];
}
