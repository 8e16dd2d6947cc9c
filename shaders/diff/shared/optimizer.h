// SPDX-License-Identifier: Apache-2.0
// Parameters of the Adam optimizer for one parameter group.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#define RELIDAR_INCLUDED_DIFF_SHARED_OPTIMIZER_H
#include "relidar/scene/surfels.h"

RELIDAR_SHARED_BEGIN

struct AdamParams {
    RELIDAR_OF(Floats, AdamValues) values;        // in place [n_rows,stride]
    RELIDAR_OF(Floats, AdamGradients) gradients;  // input [n_rows,stride]
    RELIDAR_OF(Floats, FirstMoments) moment1;     // in place
    RELIDAR_OF(Floats, SecondMoments) moment2;    // in place
    // Input [n_rows]: 1 for rows that have a gradient. Address 0 means that all rows have
    // a gradient.
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // Input [n_listed]: indices of the rows to update. Address 0 means that all n_rows
    // rows are updated.
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // Input [n_rows]: upper bound of the values in each row. If the address is 0, values
    // have no bounds.
    RELIDAR_OF(Floats, ScaleBounds) bounds;
    // Input [n_models]: factor on the learning rate of each model. Address 0 means that
    // all factors are 1.
    RELIDAR_OF(Floats, ModelRates) model_factors;
    Models models;  // input [n_models], if there are factors
    float learning_rate;
    float beta1;
    float beta2;
    float epsilon;
    float correction1;  // 1 / (1 - beta1^step)
    float correction2;  // 1 / (1 - beta2^step)
    // Factor on the learning rate of the first value of each block. Each row of `values`
    // (one surfel) is divided into blocks of `block` values. For spherical harmonics, a
    // block is a channel, and its first value is the constant coefficient.
    float first_value_factor;
    // Factor on the learning rate of the first block of each surfel's values. For
    // spherical harmonics, it is the block of the intensity channel.
    float first_block_factor;
    uint n_models;
    uint first_model_block;  // `model_factors` applies to this block and the blocks after it.
    uint first_row;          // surfel of row 0
    uint n_rows;
    uint stride;    // floats per row
    uint block;     // Number of columns per block. Column 0 of each block has a separate learning rate.
    uint n_blocks;  // blocks per row
    uint n_active;  // Number of columns at the start of each block that are updated.
};

RELIDAR_SHARED_END
#endif
