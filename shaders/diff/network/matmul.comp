// SPDX-License-Identifier: Apache-2.0
// Computes the matrix product C = scale A B for each batch entry and each attention head.
// The matrices may have any strides. A subgroup computes RELIDAR_MATMUL_ROWS rows and
// LANES columns of C. Each lane loads one column of A, and the subgroup broadcasts the
// values to all lanes. Input: a, b. Output: c.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(MatmulParams);

const uint kTileRows = RELIDAR_MATMUL_ROWS, kValuesPerLane = (kTileRows + LANES - 1u) / LANES;

void main() {
    uint tiles_x = (params.columns + LANES - 1u) / LANES,
         tiles_y = (params.rows + kTileRows - 1u) / kTileRows, lane = gl_SubgroupInvocationID;
    // One job is one tile of one matrix. Surplus subgroups compute a tile of matrix 0,
    // but store nothing.
    uint job = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID,
         matrix = job / (tiles_x * tiles_y);
    bool there = matrix < params.n_batch * params.n_heads;
    matrix = there ? matrix : 0u;
    uint batch = matrix / params.n_heads, head = matrix % params.n_heads;
    uint first_row = job / tiles_x % tiles_y * kTileRows, column = job % tiles_x * LANES + lane;
    // Index of the first value of A, and of the first value of this lane's column of B.
    uint a = params.a.first + batch * params.a.batch + head * params.a.head;
    uint b = params.b.first + batch * params.b.batch + head * params.b.head +
             min(column, params.columns - 1u) * params.b.column;
    float sum[kTileRows];
    [[unroll]] for (uint r = 0u; r < kTileRows; ++r) sum[r] = 0.0;
    // Adds the product of column k of A and row k of B. Lane l holds every LANES-th row
    // of the tile, starting with row l.
    for (uint k = 0u; k < params.inner; ++k) {
        float held[kValuesPerLane];
        [[unroll]] for (uint h = 0u; h < kValuesPerLane; ++h) {
            uint row = min(first_row + h * LANES + lane, params.rows - 1u);
            held[h] = params.a.values.at[a + row * params.a.row + k * params.a.column];
        }
        float v = params.b.values.at[b + k * params.b.row];
        [[unroll]] for (uint r = 0u; r < kTileRows; ++r) sum[r] +=
            subgroupBroadcast(held[r / LANES], r % LANES) * v;
    }
    uint c = params.c.first + batch * params.c.batch + head * params.c.head + column * params.c.column;
    [[unroll]] for (uint r = 0u; r < kTileRows;
                    ++r) if (there && column < params.columns && first_row + r < params.rows)
        params.c.values.at[c + (first_row + r) * params.c.row] = params.scale * sum[r];
}
