// SPDX-License-Identifier: Apache-2.0
// refine/conv_weights by matrix units: both operands are rounded to halves, products are summed as floats. A workgroup makes
// RELIDAR_MATRIX_TILES tiles of output channels times as many of input channels of a part, each of its subgroups one of them, all taps.
// Some columns of d_to and of a row of `from` at a time lie in shared memory, channels fastest: a tap shifts by a column.
// Input: from, d_to. Output: partial, summed by refine/sum_parts. Floor: 2 n_in n_out TAPS operations a pixel.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#include "../common/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, TAPS, 9u);
RELIDAR_CONSTANT(uint, TILE_M, 16u);
RELIDAR_CONSTANT(uint, TILE_N, 16u);
RELIDAR_CONSTANT(uint, TILE_K, 16u);
RELIDAR_PARAMS(ConvWeightsParams);

const uint kLines = TAPS == 1u ? 1u : 3u, kBefore = kLines / 2u;   // taps of a row, and columns before a value's own
const uint kTiles = RELIDAR_MATRIX_TILES, kOut = kTiles * TILE_M, kIn = kTiles * TILE_N, kPixels = 4u * TILE_K;
const uint kOutStride = kOut / 8u + 1u, kInStride = kIn / 8u + 1u;   // one more: no bank conflicts
const uint kColumns = kPixels * kOutStride;                          // where columns of `from` begin; d_to before them
const uint kHalves = kColumns + (kPixels + 2u * kBefore) * kInStride;
#include "halves.glsl"

TILE_SUM sum[TAPS];

/// Adds what the staged columns give to a row of taps. @param out_tile,in_tile  of the subgroup
void multiply(uint ky, uint out_tile, uint in_tile) {
    [[unroll]] for (uint pixel = 0u; pixel < kPixels; pixel += TILE_K) {
        TILE_A asked;
        coopMatLoad(asked, halves, pixel * kOutStride + out_tile * (TILE_M / 8u), kOutStride, gl_CooperativeMatrixLayoutColumnMajor);
        [[unroll]] for (uint kx = 0u; kx < kLines; ++kx) {
            TILE_B seen;
            coopMatLoad(seen, halves, kColumns + (pixel + kx) * kInStride + in_tile * (TILE_N / 8u), kInStride,
                        gl_CooperativeMatrixLayoutRowMajor);
            sum[ky * kLines + kx] = coopMatMulAdd(asked, seen, sum[ky * kLines + kx]);
        }
    }
}

/// Writes what this subgroup has of a tap.
void write_tile(TILE_SUM tile, uint part, uint first_out, uint first_in, uint tap) {
    uint mine = gl_SubgroupID * TILE_M * TILE_N;
    coopMatStore(tile, sums, mine, TILE_N, gl_CooperativeMatrixLayoutRowMajor);
    barrier();
    for (uint k = gl_SubgroupInvocationID; k < TILE_M * TILE_N; k += gl_SubgroupSize) {
        uint o = first_out + k / TILE_N, i = first_in + k % TILE_N;
        if (o < params.n_out && i < params.n_in)
            params.partial.at[((part * params.n_out + o) * params.n_in + i) * TAPS + tap] = sums[mine + k];
    }
    barrier();
}

void main() {
    uint in_tiles = (params.n_in + kIn - 1u) / kIn, out_tiles = (params.n_out + kOut - 1u) / kOut, group = workgroup_index();
    uint part = group / (in_tiles * out_tiles), first_in = group % in_tiles * kIn, first_out = group / in_tiles % out_tiles * kOut;
    if (part >= params.n_parts) return;
    uint n_lines = params.n_images * params.rows, n_pixels = params.rows * params.columns;
    uint line = part * n_lines / params.n_parts, end = (part + 1u) * n_lines / params.n_parts;
    uint out_tile = gl_SubgroupID / kTiles, in_tile = gl_SubgroupID % kTiles;
    bool there = first_out + out_tile * TILE_M < params.n_out && first_in + in_tile * TILE_N < params.n_in;
    [[unroll]] for (uint k = 0u; k < TAPS; ++k) sum[k] = TILE_SUM(0.0);

    for (; line < end; ++line) {
        uint image = line / params.rows, y = line % params.rows;
        uint d_at = (image * params.d_to.channels + params.d_to.first + first_out) * n_pixels + y * params.columns;
        uint from_at = (image * params.from.channels + params.from.first + first_in) * n_pixels;
        for (uint x = 0u; x < params.columns; x += kPixels) {
            barrier();
            stage(Row(params.d_to.values, d_at, params.n_out - first_out, x, params.columns), kPixels, kOut / 8u, 0u, kOutStride);
            [[unroll]] for (uint ky = 0u; ky < kLines; ++ky) {
                uint row = y + ky - kBefore;   // -1 is beyond all rows
                if (row < params.rows) {
                    barrier();
                    stage(Row(params.from.values, from_at + row * params.columns, params.n_in - first_in, x + params.columns - kBefore,
                              kRing),
                          kPixels + 2u * kBefore, kIn / 8u, kColumns, kInStride);
                    barrier();
                    if (there) multiply(ky, out_tile, in_tile);
                }
            }
        }
    }

    [[unroll]] for (uint k = 0u; k < TAPS; ++k)
        write_tile(sum[k], part, first_out + out_tile * TILE_M, first_in + in_tile * TILE_N, k);
}
