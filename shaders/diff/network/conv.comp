// SPDX-License-Identifier: Apache-2.0
// Convolution with 1x1 or 3x3 weights, computed as an implicit matrix product. Pixels
// outside the image are zero, except that columns wrap around in a circular image. The
// transposed variant is the derivative with respect to the input.
//   to[o, y, x] = bias[o] + sum_i,ky,kx weights[o, i, ky, kx]
//                                       * from[i, y + ky - 1, x + kx - 1]
//
// A subgroup computes RELIDAR_CONV_OUT channels of LANES * PIXELS columns of a row. Sums
// stay in registers, and lanes read neighbouring columns from neighbouring lanes. Weights
// are in shared memory (STAGED) or distributed over the lanes. Distribution is faster on
// a CPU, which loads lane by lane but moves values between lanes with one instruction.
//
// Input: from, weights, bias. Output or accumulated: to. Work: at least 2 n_in TAPS
// operations per value.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/refine.h"
RELIDAR_CONSTANT(uint, TAPS, 9u);
RELIDAR_CONSTANT(uint, PIXELS, 4u);
RELIDAR_CONSTANT(uint, LANES, 8u);
RELIDAR_CONSTANT(bool, STAGED, false);
RELIDAR_PARAMS(ConvParams);
#include "columns.glsl"
#include "lanes.glsl"

uint weight_index(uint out_channel, uint in_channel, uint tap) {
    return params.transposed != 0u ? (in_channel * params.n_out + out_channel) * TAPS + (TAPS - 1u - tap)
                                   : (out_channel * params.n_in + in_channel) * TAPS + tap;
}

void store_output(uint index, uint channel, float value) {
    if (!is_null(params.bias)) value += params.bias.at[channel];
    if (params.accumulate != 0u) value += params.to.values.at[index];
    params.to.values.at[index] = value;
}

const uint kTileOutChannels = RELIDAR_CONV_OUT, kTileInChannels = RELIDAR_CONV_IN,
           kWeightRows = TAPS == 1u ? 1u : 3u, kValuesPerLane = (kTileOutChannels + LANES - 1u) / LANES;
// Number of pixels that a thread loads per row. A 3x3 convolution also needs columns next
// to the pixels that it computes.
const uint kLoadsPerRow = TAPS == 1u ? PIXELS : PIXELS + 1u;
shared float tile[kTileInChannels * 9 * kTileOutChannels];  // weights of a tile, indexed [in, tap, out]

/// Copies the weights of kTileInChannels input channels (from first_in_channel) and
/// kTileOutChannels output channels to shared memory. If fewer channels remain, weights
/// of the last channel fill the other entries, which are not used.
void load_weights(uint first_out_channel, uint first_in_channel) {
    for (uint k = gl_LocalInvocationIndex; k < kTileInChannels * TAPS * kTileOutChannels;
         k += gl_WorkGroupSize.x) {
        uint o = min(first_out_channel + k % kTileOutChannels, params.n_out - 1u),
             i = min(first_in_channel + k / (kTileOutChannels * TAPS), params.n_in - 1u);
        tile[k] = params.weights.at[weight_index(o, i, k / kTileOutChannels % TAPS)];
    }
}

void load_next_weights(uint first_out_channel, uint first_in_channel) {
    barrier();
    load_weights(first_out_channel, first_in_channel);
    barrier();
}

/// Loads this lane's part of the weights of one input channel and one position (tap) of
/// the 3x3 kernel. The lanes exchange their parts later.
void load_lane_weights(uint first_out_channel, uint in_channel, uint tap,
                       out float lane_weights[kValuesPerLane]) {
    [[unroll]] for (uint k = 0u; k < kValuesPerLane; ++k) {
        uint o = min(first_out_channel + k * LANES + gl_SubgroupInvocationID, params.n_out - 1u);
        lane_weights[k] = params.weights.at[weight_index(o, in_channel, tap)];
    }
}

void main() {
    uint n_pixels = params.rows * params.columns,
         segments = (params.columns + LANES * PIXELS - 1u) / (LANES * PIXELS);
    uint out_tiles = (params.n_out + kTileOutChannels - 1u) / kTileOutChannels, group = workgroup_index(),
         lane = gl_SubgroupInvocationID;
    uint segment = group / out_tiles * (gl_WorkGroupSize.x / LANES) + gl_SubgroupID,
         line = segment / segments;
    bool there = line < params.n_images * params.rows;
    line = there ? line : 0u;
    uint first_out = group % out_tiles * kTileOutChannels,
         first_column = segment % segments * (LANES * PIXELS);
    uint image = line / params.rows, y = line % params.rows;

    uint column[kLoadsPerRow], row_at[kWeightRows];
    bool inside[kWeightRows], is_column_inside[kLoadsPerRow];
    [[unroll]] for (uint v = 0u; v < kLoadsPerRow; ++v) column[v] =
        source_column(first_column + v * LANES + lane, is_column_inside[v]);
    [[unroll]] for (uint k = 0u; k < kWeightRows; ++k) {
        // In row 0, y - 1 wraps to a large unsigned number, so that `inside` is false.
        uint row = TAPS == 1u ? y : y + k - 1u;
        inside[k] = row < params.rows;
        row_at[k] = (image * params.from.channels + params.from.first) * n_pixels +
                    (inside[k] ? row : 0u) * params.columns;
    }
    float sum[PIXELS * kTileOutChannels];
    [[unroll]] for (uint k = 0u; k < PIXELS * kTileOutChannels; ++k) sum[k] = 0.0;

    for (uint i = 0u; i < params.n_in; ++i) {
        if (STAGED && i % kTileInChannels == 0u) load_next_weights(first_out, i);
        [[unroll]] for (uint ky = 0u; ky < kWeightRows; ++ky) {
            float v[kLoadsPerRow];
            [[unroll]] for (uint k = 0u; k < kLoadsPerRow; ++k) {
                float x = params.from.values.at[row_at[ky] + i * n_pixels + column[k]];
                v[k] = inside[ky] && is_column_inside[k] ? x : 0.0;
            }
            [[unroll]] for (uint kx = 0u; kx < kWeightRows; ++kx) {
                uint tap = ky * kWeightRows + kx;
                float held[kValuesPerLane];
                if (!STAGED) load_lane_weights(first_out, i, tap, held);
                float seen[PIXELS];
                [[unroll]] for (uint p = 0u; p < PIXELS; ++p) seen[p] =
                    kx == 0u ? v[p] : read_lane(v[p], v[min(p + 1u, kLoadsPerRow - 1u)], kx);
                [[unroll]] for (uint o = 0u; o < kTileOutChannels; ++o) {
                    float w = STAGED ? tile[(i % kTileInChannels * TAPS + tap) * kTileOutChannels + o]
                                     : subgroupBroadcast(held[o / LANES], o % LANES);
                    [[unroll]] for (uint p = 0u; p < PIXELS; ++p) sum[p * kTileOutChannels + o] +=
                        w * seen[p];
                }
            }
        }
    }

    uint to = (image * params.to.channels + params.to.first + first_out) * n_pixels + y * params.columns +
              first_column + lane;
    [[unroll]] for (uint p = 0u; p < PIXELS; ++p) {
        if (!there || first_column + p * LANES + lane >= params.columns) continue;
        [[unroll]] for (uint o = 0u; o < kTileOutChannels; ++o) if (first_out + o < params.n_out)
            store_output(to + o * n_pixels + p * LANES, first_out + o, sum[p * kTileOutChannels + o]);
    }
}
