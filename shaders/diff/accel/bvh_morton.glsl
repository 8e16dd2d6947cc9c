// SPDX-License-Identifier: Apache-2.0
// Computes Morton codes, which are indices of grid cells along a space-filling curve. All
// axes use the same cell size, so that the first splits divide the longest edge of the
// bounds.
#ifndef RELIDAR_INCLUDED_DIFF_ACCEL_BVH_MORTON_GLSL
#define RELIDAR_INCLUDED_DIFF_ACCEL_BVH_MORTON_GLSL

/// Inserts two zero bits between the bits of a 10-bit number. Three such numbers are
/// interleaved to a Morton code.
uint spread_bits(uint cell) {
    cell = (cell | (cell << 16)) & 0x030000ffu;
    cell = (cell | (cell << 8)) & 0x0300f00fu;
    cell = (cell | (cell << 4)) & 0x030c30c3u;
    return (cell | (cell << 2)) & 0x09249249u;
}
uint interleave_bits(uvec3 cell) {
    return spread_bits(cell.x) << 2 | spread_bits(cell.y) << 1 | spread_bits(cell.z);
}

/// Returns the grid cell of a point. The grid covers the bounds with 2^bits cells along
/// the longest edge. A NaN coordinate gives cell 0.
uvec3 morton_cell(vec3 point, vec3 low, vec3 high, uint bits) {
    vec3 edges = high - low;
    float longest = max(max(edges.x, edges.y), edges.z), n_cells = float(1u << bits);
    float cells = longest > 0.0 && longest < 1e38 ? n_cells / longest : 0.0;
    uvec3 cell;
    for (uint c = 0u; c < 3u; ++c) {
        float position = (point[c] - low[c]) * cells;
        cell[c] = position > 0.0 ? uint(min(position, n_cells - 1.0)) : 0u;
    }
    return cell;
}
#endif
