// SPDX-License-Identifier: Apache-2.0
// Updates one parameter group with the Adam optimizer (Kingma and Ba). A thread updates a
// row on a CPU, and a single float (ONE_THREAD_PER_FLOAT) on a GPU. The gradient of a row
// that is not marked in `touched` is zero; its entry in the gradient array is not used.
// If a list of rows exists (list_touched.comp), other rows stay unchanged. Input:
// gradients, touched or rows and n_listed, bounds, model_factors, models. In place:
// values, moment1, moment2.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../scene/find_model.glsl"
#include "../../base/kernel.glsl"
#include "../shared/optimizer.h"
RELIDAR_CONSTANT(bool, ONE_THREAD_PER_FLOAT, false);
RELIDAR_PARAMS(AdamParams);

/// Updates one value with an Adam step. The values of a row are divided into blocks, for
/// example one block per channel.
/// @param block_begin position of the block's first value in the row
/// @param index_in_block position of the value in the block
/// @param model_factor factor on the learning rate for the model of the row
void update_value(uint row, uint block_begin, uint index_in_block, bool has_gradient, float model_factor) {
    uint i = row * params.stride + block_begin + index_in_block;
    // Loads the gradient even if it is not needed, because on a CPU a load in a branch is
    // slower.
    float g = ONE_THREAD_PER_FLOAT && !has_gradient ? 0.0 : params.gradients.at[i];
    g = has_gradient ? g : 0.0;
    float m = mix(g, params.moment1.at[i], params.beta1);
    float v = mix(g * g, params.moment2.at[i], params.beta2);
    params.moment1.at[i] = m;
    params.moment2.at[i] = v;
    float rate = params.learning_rate * (index_in_block == 0u ? params.first_value_factor : 1.0) *
                 (block_begin == 0u ? params.first_block_factor : 1.0) *
                 (block_begin >= params.first_model_block * params.block ? model_factor : 1.0);
    float value = params.values.at[i] -
                  rate * (m * params.correction1) / (sqrt(v * params.correction2) + params.epsilon);
    // Limits the value by a comparison instead of min(), because min() could replace a
    // NaN. Later checks search for NaNs.
    if (!is_null(params.bounds) && value > params.bounds.at[row]) value = params.bounds.at[row];
    params.values.at[i] = value;
}

/// Updates all values of a row with an Adam step. With ONE_THREAD_PER_FLOAT, updates a
/// single value.
/// @param row_or_value index of the row; with ONE_THREAD_PER_FLOAT, index of the value
void update_row(uint row_or_value) {
    uint n_updated = params.n_blocks * params.n_active,
         row = ONE_THREAD_PER_FLOAT ? row_or_value / n_updated : row_or_value;
    if (!is_null(params.rows)) row = params.rows.at[row];
    bool has_gradient = is_null(params.touched) || params.touched.at[row] != 0u;
    float model_factor = 1.0;
    if (!is_null(params.model_factors))
        model_factor =
            params.model_factors.at[find_model(params.models, params.n_models, params.first_row + row)];
    if (ONE_THREAD_PER_FLOAT) {
        uint k = row_or_value % n_updated;
        update_value(row, k / params.n_active * params.block, k % params.n_active, has_gradient,
                     model_factor);
        return;
    }
    // Uses nested loops instead of integer divisions, which are slow on a CPU.
    for (uint block = 0u; block < params.stride; block += params.block)
        for (uint within = 0u; within < params.n_active; ++within)
            update_value(row, block, within, has_gradient, model_factor);
}

void main() {
    uint n_rows = is_null(params.rows) ? params.n_rows : params.n_listed.at[0];
    uint n = ONE_THREAD_PER_FLOAT ? n_rows * params.n_blocks * params.n_active : n_rows;
    for (uint i = thread_index(); i < n; i += thread_count()) update_row(i);
}
