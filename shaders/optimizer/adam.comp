// SPDX-License-Identifier: Apache-2.0
// Adam (Kingma and Ba) over one parameter group, one thread a row, or a float (PER_FLOAT): neighbouring threads then read neighbouring
// addresses, which a GPU loads together; a CPU gains nothing by it. Gradients of rows not touched do not count: they are zero, or the row
// is left as it is.
// Input: gradients, touched, bounds, model_scale, models. In place: values, moment1, moment2.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/find_model.glsl"
#include "../common/kernel.glsl"
#include "../shared/optimizer.h"
RELIDAR_CONSTANT(bool, PER_FLOAT, false);
RELIDAR_PARAMS(AdamParams);

void update(uint row, uint column, bool has_gradient, float learning_rate) {
    uint within = column % params.block;
    if (within >= params.n_active) return;
    uint i = row * params.stride + column;
    float g = PER_FLOAT && !has_gradient ? 0.0 : params.gradients.at[i];   // lanes of a CPU load faster than they branch
    g = has_gradient ? g : 0.0;
    float m = mix(g, params.moment1.at[i], params.beta1);
    float v = mix(g * g, params.moment2.at[i], params.beta2);
    params.moment1.at[i] = m;
    params.moment2.at[i] = v;
    float rate = learning_rate * (within == 0u ? params.first_scale : 1.0) * (column < params.block ? params.block_scale : 1.0);
    float value = params.values.at[i] - rate * (m * params.correction1) / (sqrt(v * params.correction2) + params.epsilon);
    if (!is_null(params.bounds) && value > params.bounds.at[row]) value = params.bounds.at[row];   // a NaN stays, for somebody looks for it
    params.values.at[i] = value;
}

void main() {
    uint i = thread_index(), row = PER_FLOAT ? i / params.stride : i;
    if (row >= params.n_rows) return;
    bool has_gradient = is_null(params.touched) || params.touched.at[row] != 0u;
    if (!has_gradient && params.only_touched != 0u) return;
    float learning_rate = params.learning_rate;
    if (!is_null(params.model_scale))
        learning_rate *= params.model_scale.at[find_model(params.models, params.n_models, params.first_row + row)];
    if (PER_FLOAT) update(row, i % params.stride, has_gradient, learning_rate);
    else
        for (uint column = 0u; column < params.stride; ++column) update(row, column, has_gradient, learning_rate);
}
