// SPDX-License-Identifier: Apache-2.0
// Adam over one parameter group.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#define RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#include "relidar/scene/surfels.h"

RELIDAR_SHARED_BEGIN

struct AdamParams {
    RELIDAR_OF(Floats, AdamValues) values;        // in place [n_rows,stride]
    RELIDAR_OF(Floats, AdamGradients) gradients;  // input [n_rows,stride]
    RELIDAR_OF(Floats, FirstMoments) moment1;     // in place
    RELIDAR_OF(Floats, SecondMoments) moment2;    // in place
    RELIDAR_OF(Uints, TouchedSurfels) touched;    // input [n_rows] rows with a gradient, or address 0 = all
    // input [n_listed] which rows are stepped, or address 0 = all n_rows
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // input [n_rows] no value of a row is stepped beyond it, or address 0 = none
    RELIDAR_OF(Floats, ScaleBounds) bounds;
    // input [n_models] learning-rate factor of the rows of each model, or address 0 = 1
    RELIDAR_OF(Floats, ModelRates) model_scale;
    Models models;  // input [n_models] where there are factors
    float learning_rate;
    float beta1;
    float beta2;
    float epsilon;
    float correction1;  // 1 / (1 - beta1^step)
    float correction2;  // 1 / (1 - beta2^step)
    float first_scale;  // learning-rate factor of column 0 of each block (SH: DC against the rest)
    // learning-rate factor of the first block (SH: the intensity against the drop logits)
    float block_scale;
    uint n_models;
    uint first_row;  // surfel of row 0
    uint n_rows;
    uint stride;    // floats a row
    uint block;     // columns a block: column 0 of each block has its own rate
    uint n_blocks;  // of a row
    uint n_active;  // columns updated in each block, the first ones
};

RELIDAR_SHARED_END
#endif
