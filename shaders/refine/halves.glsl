// SPDX-License-Identifier: Apache-2.0
// Operands of matrix units in shared memory: words of eight halves, of as many consecutive channels, so that every row of a tile begins at
// a multiple of 16 bytes, whichever column it begins with. Include after RELIDAR_PARAMS and `kHalves`, the number of words.
#ifndef RELIDAR_INCLUDED_REFINE_HALVES_GLSL
#define RELIDAR_INCLUDED_REFINE_HALVES_GLSL
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require

#define TILE_A coopmat<float16_t, gl_ScopeSubgroup, TILE_M, TILE_K, gl_MatrixUseA>
#define TILE_B coopmat<float16_t, gl_ScopeSubgroup, TILE_K, TILE_N, gl_MatrixUseB>
#define TILE_SUM coopmat<float, gl_ScopeSubgroup, TILE_M, TILE_N, gl_MatrixUseAccumulator>

const uint kRing = 0xffffffffu;

shared uvec4 halves[kHalves];
shared float sums[RELIDAR_MATRIX_GROUPS * TILE_M * TILE_N];   // a tile of each subgroup, on its way to memory

uint two_halves(vec2 v) { return packHalf2x16(vec2(in_half(v.x), in_half(v.y))); }

uvec4 eight_halves(float v[8]) {
    return uvec4(two_halves(vec2(v[0], v[1])), two_halves(vec2(v[2], v[3])), two_halves(vec2(v[4], v[5])), two_halves(vec2(v[6], v[7])));
}

/// Columns of a row of images that become halves.
struct Row {
    Values values;
    uint at;               // of the first channel's column 0
    uint n_channels;       // that there are; those beyond are zeros
    uint first;            // column
    uint end;              // columns from here on are zeros; kRing: the ring goes on
};

/// Puts 8 * `octets` channels of `pixels` columns at halves[at + pixel * stride + octet].
void stage(Row row, uint pixels, uint octets, uint at, uint stride) {
    uint n_pixels = params.rows * params.columns;
    for (uint k = gl_LocalInvocationIndex; k < pixels * octets; k += gl_WorkGroupSize.x) {
        uint pixel = k % pixels, octet = k / pixels, column = row.first + pixel;
        float v[8];
        [[unroll]] for (uint j = 0u; j < 8u; ++j) {
            uint channel = octet * 8u + j;
            float x = float(row.values.at[row.at + min(channel, row.n_channels - 1u) * n_pixels + column % params.columns]);
            v[j] = channel < row.n_channels && column < row.end ? x : 0.0;
        }
        halves[at + pixel * stride + octet] = eight_halves(v);
    }
}
#endif
