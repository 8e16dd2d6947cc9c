// SPDX-License-Identifier: Apache-2.0
// Parameters of the layers of the ray-drop network: convolution, normalisation and change
// of size. Images are [n_images, channels, rows, columns], columns fastest. Columns wrap
// around (azimuth), rows end at the field of view.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#include "images.h"

#define RELIDAR_CONV_OUT 8  // channels that a subgroup of network/conv or network/conv_weights computes
// Input channels whose weights a workgroup of network/conv holds at a time, or that a
// subgroup of network/conv_weights processes (1x1).
#define RELIDAR_CONV_IN 8
// pixels of a channel that a thread of network/norm or network/norm_vjp computes
#define RELIDAR_NORM_PIXELS 8

RELIDAR_SHARED_BEGIN

struct ConvParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice to;    // output, or accumulated [n_images, n_out, rows, columns]
    // Input [n_out,n_in,TAPS]; [n_in,n_out,TAPS] if `transposed`.
    RELIDAR_OF(Floats, ConvWeights) weights;
    RELIDAR_OF(Floats, ConvBias) bias;  // input [n_out], or address 0
    uint n_images;
    uint rows;
    uint columns;
    uint n_in;
    uint n_out;
    uint transposed;  // 1: derivative with respect to the input: swapped channels, mirrored taps
    uint accumulate;  // 1: adds to the stored values
};

struct ConvWeightsParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice d_to;  // input [n_images, n_out, rows, columns]
    // Output [n_parts, n_out, n_in, TAPS] sums over the rows of a part.
    RELIDAR_OF(Floats, PartSums) partial;
    uint n_images;
    uint rows;
    uint columns;
    uint n_in;
    uint n_out;
    uint n_parts;
};

struct SumPartsParams {
    RELIDAR_OF(Floats, PartSums) partial;  // input [n_parts, n]
    RELIDAR_OF(Floats, SumOfParts) sum;    // output [n]
    uint n_parts;
    uint n;
};

// Parameters of the sums over the pixels of channels, split into parts.
struct ChannelSumsParams {
    ImageSlice from;  // input
    ImageSlice d_to;  // input, for kSums_norm_vjp: gradient of the output of network/norm
    // Output [n_parts, channels, 2], or [n_parts, channels] for kSums_plain.
    RELIDAR_OF(Floats, PartSums) partial;
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels], for kSums_norm_vjp
    RELIDAR_OF(Vec2s, NormMoments) moments;     // input [channels], for kSums_norm_vjp
    uint kind;
    uint n_images;
    uint n_pixels;  // pixels per image
    uint n_channels;
    uint n_parts;  // a multiple of n_images, because a part lies within one image
    uint dropout_key;
    float dropout;
};
#ifdef __cplusplus
constexpr uint kSums_moments = 0;   // mean of the part, and sum of squares about the mean
constexpr uint kSums_norm_vjp = 1;  // dL/d(beta), dL/d(gamma)
constexpr uint kSums_plain = 2;     // the sum: derivative with respect to a bias
#else
const uint kSums_moments = 0u, kSums_norm_vjp = 1u, kSums_plain = 2u;
#endif

struct NormFinishParams {
    RELIDAR_OF(Floats, PartSums) partial;     // input [n_parts, channels, 2] of kSums_moments
    RELIDAR_OF(Vec2s, BetaGamma) beta_gamma;  // input [channels]
    // In place [channels] mean and variance; only read if `training` is 0.
    RELIDAR_OF(Vec2s, RunningMoments) running;
    RELIDAR_OF(Vec2s, NormMoments) moments;  // output [channels] mean and 1 / deviation
    // Output [channels]: gamma * normalised + beta = scale x + shift.
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;
    uint n_channels;
    uint n_parts;  // parts of all images
    uint n_images;
    uint n_pixels;  // pixels per image
    uint training;
    float momentum;  // weight of the new batch in `running`
    float epsilon;
};

struct NormParams {
    ImageSlice from;                            // input
    ImageSlice to;                              // output
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels]
    uint n_images;
    uint n_pixels;  // pixels per image
    uint n_channels;
    uint dropout_key;  // the dropout mask depends only on this key and on the position of a value
    float dropout;     // share of dropped values; 0: no dropout
};

struct NormVjpParams {
    ImageSlice from;                            // input of the normalisation
    ImageSlice d_to;                            // input
    ImageSlice d_from;                          // output, or accumulated
    RELIDAR_OF(Vec2s, BetaGamma) d_beta_gamma;  // input [channels]
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels]
    RELIDAR_OF(Vec2s, NormMoments) moments;     // input [channels]
    uint n_images;
    uint n_pixels;
    uint n_channels;
    uint dropout_key;
    float dropout;
    uint accumulate;  // 1: adds to the stored values
};

struct ResampleParams {
    ImageSlice from;    // input
    ImageSlice to;      // output; in place for network/pool_vjp
    ImageSlice pooled;  // input of the pooling; only for network/pool_vjp
    uint n_images;
    uint n_channels;
    uint rows;  // size of the larger images
    uint columns;
    uint small_rows;  // size of the smaller images
    uint small_columns;
};

RELIDAR_SHARED_END
#endif
