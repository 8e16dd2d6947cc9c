// SPDX-License-Identifier: Apache-2.0
// Batches of rays.
#ifndef RELIDAR_INCLUDED_SHARED_TRAIN_H
#define RELIDAR_INCLUDED_SHARED_TRAIN_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

/// Whole columns of a frame, one beside the other, as an image of their own.
struct GatherColumnsParams {
    Rays rays;               // input [rows,columns]
    Targets targets;         // input [rows,columns]
    Rays batch_rays;         // output [rows,n_columns]
    Targets batch_targets;   // output [rows,n_columns]
    uint rows;
    uint columns;
    uint first_column;       // columns wrap around behind the last one
    uint n_columns;
};

RELIDAR_SHARED_END
#endif
