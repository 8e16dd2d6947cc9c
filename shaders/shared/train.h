// SPDX-License-Identifier: Apache-2.0
// Batches of rays.
#ifndef RELIDAR_INCLUDED_SHARED_TRAIN_H
#define RELIDAR_INCLUDED_SHARED_TRAIN_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

/// Some columns of a frame, whole and one beside the other, as an image of their own: column k is first_column + k column_stride of the
/// frame, which wraps around.
struct GatherColumnsParams {
    Rays rays;               // input [rows,columns]
    Targets targets;         // input [rows,columns]
    Rays batch_rays;         // output [rows,n_columns]
    Targets batch_targets;   // output [rows,n_columns]
    uint rows;
    uint columns;
    uint first_column;
    uint column_stride;
    uint n_columns;
};

RELIDAR_SHARED_END
#endif
