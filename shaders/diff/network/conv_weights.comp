// SPDX-License-Identifier: Apache-2.0
// Computes the derivative of a convolution with respect to its weights. The rows of the
// images are split into parts:
//   partial[part, o, i, ky, kx] = sum_y,x d_to[o, y, x] from[i, y + ky - 1, x + kx - 1]
//
// A subgroup computes RELIDAR_CONV_OUT output channels of one input channel, or of
// RELIDAR_CONV_IN input channels for 1x1. Each lane sums over some columns, and the sums
// of all lanes are added at the end. Input: from, d_to. Output: partial, which
// network/sum_parts sums. Work: at least 2 n_in n_out TAPS operations per pixel.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, TAPS, 9u);
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_PARAMS(ConvWeightsParams);
#include "columns.glsl"
#include "lanes.glsl"

const uint kTileOutChannels = RELIDAR_CONV_OUT, kTileInChannels = TAPS == 1u ? RELIDAR_CONV_IN : 1u,
           kWeightRows = TAPS == 1u ? 1u : 3u;

float sum[kTileOutChannels * kTileInChannels * TAPS];  // partial sums of this lane, indexed [out, in, tap]
// Input pixels, indexed [input channel, kernel row]. Lane l holds column l of the current
// block of LANES image columns (`before`) and of the next block (`next`). A 3x3 kernel
// needs three columns, so a lane reads the next two columns from other lanes.
float before[kTileInChannels * kWeightRows], next[kTileInChannels * kWeightRows];
float d_out[kTileOutChannels];  // d_to of the lane's column

/// Each thread processes one column of an image row. Adds the contribution of this column
/// to `sum`, the thread's partial sums of the weight gradient.
void add_column() {
    [[unroll]] for (uint k = 0u; k < kTileInChannels * kWeightRows; ++k)
        [[unroll]] for (uint kx = 0u; kx < kWeightRows; ++kx) {
        float seen = kx == 0u ? before[k] : read_lane(before[k], next[k], kx);
        [[unroll]] for (uint o = 0u; o < kTileOutChannels; ++o)
            sum[o * kTileInChannels * TAPS + k * kWeightRows + kx] += d_out[o] * seen;
    }
}

void main() {
    uint in_tiles = (params.n_in + kTileInChannels - 1u) / kTileInChannels,
         out_tiles = (params.n_out + kTileOutChannels - 1u) / kTileOutChannels,
         lane = gl_SubgroupInvocationID;
    uint job = workgroup_index() * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID,
         part = job / (in_tiles * out_tiles);
    uint first_in = job % in_tiles * kTileInChannels,
         first_out = job / in_tiles % out_tiles * kTileOutChannels;
    uint n_lines = params.n_images * params.rows, n_pixels = params.rows * params.columns;
    uint line = min(part, params.n_parts) * n_lines / params.n_parts,
         end = min(part + 1u, params.n_parts) * n_lines / params.n_parts;
    [[unroll]] for (uint k = 0u; k < kTileOutChannels * kTileInChannels * TAPS; ++k) sum[k] = 0.0;

    for (; line < end; ++line) {
        uint image = line / params.rows, y = line % params.rows, row_at[kTileInChannels * kWeightRows];
        bool inside[kTileInChannels * kWeightRows];
        bool is_column_inside;
        uint column = source_column(lane, is_column_inside);
        [[unroll]] for (uint k = 0u; k < kTileInChannels * kWeightRows; ++k) {
            // A 3x3 kernel at y = 0 needs row -1, which is zero padding. `row` then wraps
            // to a large unsigned number, so that inside[k] is false.
            uint row = TAPS == 1u ? y : y + k % kWeightRows - 1u,
                 i = min(first_in + k / kWeightRows, params.n_in - 1u);
            inside[k] = row < params.rows;
            row_at[k] = (image * params.from.channels + params.from.first + i) * n_pixels +
                        (inside[k] ? row : 0u) * params.columns;
            float v = params.from.values.at[row_at[k] + column];
            next[k] = inside[k] && is_column_inside ? v : 0.0;
        }
        for (uint x = 0u; x < params.columns; x += LANES) {
            column = source_column(x + LANES + lane, is_column_inside);
            [[unroll]] for (uint k = 0u; k < kTileInChannels * kWeightRows; ++k) {
                before[k] = next[k];
                float v = params.from.values.at[row_at[k] + column];
                next[k] = inside[k] && is_column_inside ? v : 0.0;
            }
            bool there = x + lane < params.columns;
            [[unroll]] for (uint o = 0u; o < kTileOutChannels; ++o) {
                uint channel = params.d_to.first + min(first_out + o, params.n_out - 1u);
                uint plane = (image * params.d_to.channels + channel) * n_pixels;
                float d = params.d_to.values.at[plane + y * params.columns + (there ? x + lane : 0u)];
                d_out[o] = there ? d : 0.0;
            }
            add_column();
        }
    }

    [[unroll]] for (uint k = 0u; k < kTileOutChannels * kTileInChannels * TAPS; ++k) {
        float total = subgroupAdd(sum[k]);
        uint o = first_out + k / (kTileInChannels * TAPS), i = first_in + k / TAPS % kTileInChannels;
        if (lane == 0u && part < params.n_parts && o < params.n_out && i < params.n_in)
            params.partial.at[((part * params.n_out + o) * params.n_in + i) * TAPS + k % TAPS] = total;
    }
}
