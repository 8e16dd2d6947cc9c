// SPDX-License-Identifier: Apache-2.0
// Parameters of Adam for one parameter group.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#define RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#include "relidar/scene/surfels.h"

RELIDAR_SHARED_BEGIN

struct AdamParams {
    RELIDAR_OF(Floats, AdamValues) values;        // in place [n_rows,stride]
    RELIDAR_OF(Floats, AdamGradients) gradients;  // input [n_rows,stride]
    RELIDAR_OF(Floats, FirstMoments) moment1;     // in place
    RELIDAR_OF(Floats, SecondMoments) moment2;    // in place
    // input [n_rows] rows with a gradient, or address 0 = all rows
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // Input [n_listed] rows that are updated, or address 0 = all n_rows.
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // Input [n_rows] upper bound of the values of each row, or address 0 = no bounds.
    RELIDAR_OF(Floats, ScaleBounds) bounds;
    // Input [n_models] learning-rate factor of the rows of each model, or address 0 = 1.
    RELIDAR_OF(Floats, ModelRates) model_scale;
    Models models;  // input [n_models], if there are factors
    float learning_rate;
    float beta1;
    float beta2;
    float epsilon;
    float correction1;  // 1 / (1 - beta1^step)
    float correction2;  // 1 / (1 - beta2^step)
    float first_scale;  // learning-rate factor of column 0 of each block (SH: DC coefficient)
    // Learning-rate factor of the first block (SH: the intensity, in contrast to the drop
    // logits).
    float block_scale;
    uint n_models;
    uint first_row;  // surfel of row 0
    uint n_rows;
    uint stride;    // floats per row
    uint block;     // columns per block; column 0 of each block has a separate rate
    uint n_blocks;  // blocks per row
    uint n_active;  // number of leading columns of each block that are updated
};

RELIDAR_SHARED_END
#endif
