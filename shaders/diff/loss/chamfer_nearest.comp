// SPDX-License-Identifier: Apache-2.0
// For each point of one cloud, finds the exact nearest point of another cloud. Both
// clouds have the same image layout. First tests the point in the same pixel and in the
// tile around it. Then searches only boxes that are nearer than the best point so far.
//
// Rounding cannot change the result. The distance to a box uses the same operations in
// the same order as the distance to a point in the box. So the distance to the box is
// never larger. One thread per point. Input: queries, cloud. Output: nearest.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
RELIDAR_PARAMS(ChamferNearestParams);

struct Nearest {
    vec3 query;
    float squared_m2;
    uint index;
};

float squared_length(vec3 direction) {
    precise float sum = direction.x * direction.x;
    precise float y = direction.y * direction.y;
    precise float z = direction.z * direction.z;
    sum = sum + y;
    sum = sum + z;
    return sum;
}

/// Returns the squared distance between a point and a box. For an empty box, whose
/// corners are RELIDAR_NO_POINT, the square overflows to infinity.
float squared_distance(vec3 query, vec3 low, vec3 high) {
    return squared_length(max(max(low - query, query - high), vec3(0.0)));
}

void visit_point(uint index, inout Nearest best) {
    vec3 p = params.cloud.points.at[index];
    float squared = squared_length(best.query - p);
    if (p.x < RELIDAR_NO_POINT && squared < best.squared_m2) {
        best.squared_m2 = squared;
        best.index = index;
    }
}

/// Rectangle of a grid that is searched for the nearest point. The cells are pixels, or
/// tiles of pixels.
struct Cells {
    // Index of the first row and column (begin), and index after the last row and column
    // (end).
    uvec2 begin, end;
    uint across;  // number of points or tiles per row of the image
};

Cells tile_cells(uint tile, uvec2 grid_size, uint tiles_per_row) {
    uvec2 tile_size = uvec2(params.tile_rows, params.tile_columns),
          begin = uvec2(tile / tiles_per_row, tile % tiles_per_row) * tile_size;
    return Cells(begin, min(begin + tile_size, grid_size), grid_size.y);
}

uvec2 count_tiles(uvec2 grid_size) {
    uvec2 tile_size = uvec2(params.tile_rows, params.tile_columns);
    return (grid_size + tile_size - 1u) / tile_size;
}

void search_tile(uint tile, uvec2 image_size, uint tiles_per_row, inout Nearest best) {
    if (!(squared_distance(best.query, params.cloud.tile_low.at[tile], params.cloud.tile_high.at[tile]) <
          best.squared_m2))
        return;
    Cells c = tile_cells(tile, image_size, tiles_per_row);
    for (uint row = c.begin.x; row < c.end.x; ++row)
        for (uint column = c.begin.y; column < c.end.y; ++column) visit_point(row * c.across + column, best);
}

void main() {
    uint k = thread_index();
    if (k >= params.rows * params.columns) return;
    // The distance starts at infinity (0x7f800000).
    Nearest best = Nearest(params.queries.at[k], uintBitsToFloat(0x7f800000u), RELIDAR_NO_INDEX);
    if (best.query.x < RELIDAR_NO_POINT) {
        uvec2 points = uvec2(params.rows, params.columns), tiles = count_tiles(points),
              groups = count_tiles(tiles);
        visit_point(k, best);
        // Tile that contains pixel k.
        search_tile(
            k / params.columns / params.tile_rows * tiles.y + k % params.columns / params.tile_columns,
            points, tiles.y, best);
        for (uint group = 0u; group < groups.x * groups.y; ++group) {
            if (!(squared_distance(best.query, params.cloud.group_low.at[group],
                                   params.cloud.group_high.at[group]) < best.squared_m2))
                continue;
            Cells c = tile_cells(group, tiles, groups.y);
            for (uint row = c.begin.x; row < c.end.x; ++row)
                for (uint column = c.begin.y; column < c.end.y; ++column)
                    search_tile(row * c.across + column, points, tiles.y, best);
        }
    }
    params.nearest.at[k] = best.index;
}
