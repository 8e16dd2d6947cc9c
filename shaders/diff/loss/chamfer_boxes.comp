// SPDX-License-Identifier: Apache-2.0
// Computes the bounding box of each tile of an image. Each pixel of the image contains a
// point or a smaller box. One thread per tile. Input: low, high. Output: tile_low,
// tile_high.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
RELIDAR_PARAMS(ChamferBoxesParams);

void main() {
    uint tile = thread_index();
    uint tiles_across = (params.columns + params.tile_columns - 1u) / params.tile_columns;
    uint first_row = tile / tiles_across * params.tile_rows,
         first_column = tile % tiles_across * params.tile_columns;
    if (first_row >= params.rows) return;
    vec3 low = vec3(RELIDAR_NO_POINT), high = vec3(-RELIDAR_NO_POINT);
    for (uint row = first_row; row < min(first_row + params.tile_rows, params.rows); ++row) {
        for (uint column = first_column; column < min(first_column + params.tile_columns, params.columns);
             ++column) {
            uint i = row * params.columns + column;
            if (params.low.at[i].x >= RELIDAR_NO_POINT) continue;
            low = min(low, params.low.at[i]);
            high = max(high, params.high.at[i]);
        }
    }
    params.tile_low.at[tile] = low;
    // An empty tile has RELIDAR_NO_POINT at both corners: its distance is infinite.
    params.tile_high.at[tile] = low.x >= RELIDAR_NO_POINT ? low : high;
}
