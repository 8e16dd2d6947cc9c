// SPDX-License-Identifier: Apache-2.0
// refine/conv by matrix units: both operands are rounded to halves, products are summed as floats. A workgroup makes
// RELIDAR_MATRIX_OUT * TILE_M channels of some columns of a row, each of its subgroups RELIDAR_MATRIX_TILES * TILE_N of these columns. For
// TILE_K input channels and a row of taps at a time, columns and weights lie in shared memory, channels fastest: a tap shifts by a column,
// so nothing is copied for it.
// Input: from, weights, bias. Output or accumulated: to. Floor: 2 n_in TAPS operations a value.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#include "../common/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, TAPS, 9u);
RELIDAR_CONSTANT(uint, TILE_M, 16u);
RELIDAR_CONSTANT(uint, TILE_N, 16u);
RELIDAR_CONSTANT(uint, TILE_K, 16u);
RELIDAR_PARAMS(ConvParams);

const uint kLines = TAPS == 1u ? 1u : 3u, kBefore = kLines / 2u;   // taps of a row, and columns before a value's own
const uint kTiles = RELIDAR_MATRIX_TILES, kOutTiles = RELIDAR_MATRIX_OUT, kOut = kOutTiles * TILE_M;
const uint kPixels = RELIDAR_MATRIX_GROUPS * kTiles * TILE_N;
const uint kOctets = TILE_K / 8u, kStride = kOctets + 1u;          // one more: no bank conflicts
const uint kColumns = kLines * kOut * kStride;                     // where columns begin; [tap, out] before them
const uint kHalves = kColumns + (kPixels + 2u * kBefore) * kStride;
#include "conv.glsl"
#include "halves.glsl"

TILE_SUM sum[kOutTiles * kTiles];

/// Weights of a row of taps for TILE_K input channels and the output channels of this workgroup.
void stage_weights(uint first_out, uint first_in, uint ky) {
    for (uint k = gl_LocalInvocationIndex; k < kLines * kOut * kOctets; k += gl_WorkGroupSize.x) {
        uint kx = k % kLines, o = k / kLines % kOut, octet = k / (kLines * kOut);
        float v[8];
        [[unroll]] for (uint j = 0u; j < 8u; ++j) {
            uint i = first_in + octet * 8u + j, out_channel = first_out + o;
            float w = params.weights.at[weight_index(min(out_channel, params.n_out - 1u), min(i, params.n_in - 1u), ky * kLines + kx)];
            v[j] = i < params.n_in && out_channel < params.n_out ? w : 0.0;
        }
        halves[(kx * kOut + o) * kStride + octet] = eight_halves(v);
    }
}

/// Adds what the staged taps give to columns from `pixel` on. @param n_out  output channels that there are
void multiply(uint pixel, uint n_out) {
    [[unroll]] for (uint kx = 0u; kx < kLines; ++kx) {
        TILE_B seen[kTiles];
        [[unroll]] for (uint p = 0u; p < kTiles; ++p)
            coopMatLoad(seen[p], halves, kColumns + (pixel + p * TILE_N + kx) * kStride, kStride, gl_CooperativeMatrixLayoutColumnMajor);
        [[unroll]] for (uint o = 0u; o < kOutTiles; ++o) {
            if (o * TILE_M >= n_out) continue;
            TILE_A weights;
            coopMatLoad(weights, halves, (kx * kOut + o * TILE_M) * kStride, kStride, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint p = 0u; p < kTiles; ++p) sum[o * kTiles + p] = coopMatMulAdd(weights, seen[p], sum[o * kTiles + p]);
        }
    }
}

/// Writes what this subgroup has of a tile. @param to  index of its first channel's column 0
void write_tile(TILE_SUM tile, uint first_out, uint first_column, uint to) {
    uint mine = gl_SubgroupID * TILE_M * TILE_N;
    coopMatStore(tile, sums, mine, TILE_N, gl_CooperativeMatrixLayoutRowMajor);
    barrier();
    for (uint k = gl_SubgroupInvocationID; k < TILE_M * TILE_N; k += gl_SubgroupSize) {
        uint o = k / TILE_N, column = first_column + k % TILE_N;
        if (first_out + o < params.n_out && column < params.columns)
            put(to + o * params.rows * params.columns + column, first_out + o, sums[mine + k]);
    }
    barrier();
}

void main() {
    uint segments = (params.columns + kPixels - 1u) / kPixels, out_tiles = (params.n_out + kOut - 1u) / kOut, group = workgroup_index();
    uint line = group / out_tiles / segments, first_column = group / out_tiles % segments * kPixels, first_out = group % out_tiles * kOut;
    if (line >= params.n_images * params.rows) return;
    uint image = line / params.rows, y = line % params.rows, n_pixels = params.rows * params.columns;
    uint pixel = gl_SubgroupID * kTiles * TILE_N;   // the subgroup's first
    [[unroll]] for (uint k = 0u; k < kOutTiles * kTiles; ++k) sum[k] = TILE_SUM(0.0);

    for (uint i = 0u; i < params.n_in; i += TILE_K)
        for (uint ky = 0u; ky < kLines; ++ky) {
            uint row = y + ky - kBefore;   // -1 is beyond all rows
            if (row >= params.rows) continue;
            uint at = (image * params.from.channels + params.from.first + i) * n_pixels + row * params.columns;
            barrier();
            stage_weights(first_out, i, ky);
            stage(Row(params.from.values, at, params.n_in - i, first_column + params.columns - kBefore, kRing),
                  kPixels + 2u * kBefore, kOctets, kColumns, kStride);
            barrier();
            if (first_column + pixel < params.columns) multiply(pixel, params.n_out - first_out);
        }

    [[unroll]] for (uint o = 0u; o < kOutTiles; ++o)
        [[unroll]] for (uint p = 0u; p < kTiles; ++p) {
            uint channel = first_out + o * TILE_M;
            uint to = (image * params.to.channels + params.to.first + channel) * n_pixels + y * params.columns;
            write_tile(sum[o * kTiles + p], channel, first_column + pixel + p * TILE_N, to);
        }
}
