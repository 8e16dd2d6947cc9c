// SPDX-License-Identifier: Apache-2.0
// Convolution, normalisation and change of size: layers of the ray-drop network. Images
// are [n_images, channels, rows, columns], columns fastest; columns are a ring (azimuth),
// rows end at the field of view.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#include "images.h"

#define RELIDAR_CONV_OUT 8  // channels that a subgroup of refine/conv or refine/conv_weights makes
// channels whose weights a workgroup of refine/conv holds at a time, or of
// refine/conv_weights makes (1x1)
#define RELIDAR_CONV_IN 8
#define RELIDAR_NORM_PIXELS 8  // of a channel that a thread of refine/norm or refine/norm_vjp makes

RELIDAR_SHARED_BEGIN

struct ConvParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice to;    // output, or accumulated [n_images, n_out, rows, columns]
    // input [n_out,n_in,TAPS]; with `transposed` [n_in,n_out,TAPS]
    RELIDAR_OF(Floats, ConvWeights) weights;
    RELIDAR_OF(Floats, ConvBias) bias;  // input [n_out], or address 0
    uint n_images;
    uint rows;
    uint columns;
    uint n_in;
    uint n_out;
    uint transposed;  // 1: the derivative by the input: channels change places, taps are mirrored
    uint accumulate;  // 1: adds to what is there
};

struct ConvWeightsParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice d_to;  // input [n_images, n_out, rows, columns]
    // output [n_parts, n_out, n_in, TAPS] sums over the rows of a part
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

// Sums over the pixels of channels, in parts of the pixels.
struct ChannelSumsParams {
    ImageSlice from;  // input
    ImageSlice d_to;  // input, for kSums_norm_vjp: gradient of what refine/norm has written
    // output [n_parts, channels, 2], for kSums_plain [n_parts, channels]
    RELIDAR_OF(Floats, PartSums) partial;
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels], for kSums_norm_vjp
    RELIDAR_OF(Vec2s, NormMoments) moments;     // input [channels], for kSums_norm_vjp
    uint kind;
    uint n_images;
    uint n_pixels;  // of an image
    uint n_channels;
    uint n_parts;  // a multiple of n_images: a part lies in one of them
    uint dropout_key;
    float dropout;
};
#ifdef __cplusplus
constexpr uint kSums_moments = 0;   // mean of the part, and sum of squares about it
constexpr uint kSums_norm_vjp = 1;  // dL/d(beta), dL/d(gamma)
constexpr uint kSums_plain = 2;     // the sum: derivative by a bias
#else
const uint kSums_moments = 0u, kSums_norm_vjp = 1u, kSums_plain = 2u;
#endif

struct NormFinishParams {
    RELIDAR_OF(Floats, PartSums) partial;     // input [n_parts, channels, 2] of kSums_moments
    RELIDAR_OF(Vec2s, BetaGamma) beta_gamma;  // input [channels]
    // in place [channels] mean and variance; input where `training` is 0
    RELIDAR_OF(Vec2s, RunningMoments) running;
    RELIDAR_OF(Vec2s, NormMoments) moments;  // output [channels] mean and 1 / deviation
    // output [channels]: gamma * normalised + beta = scale x + shift
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;
    uint n_channels;
    uint n_parts;  // of all images
    uint n_images;
    uint n_pixels;  // of an image
    uint training;
    float momentum;  // share of the new batch in `running`
    float epsilon;
};

struct NormParams {
    ImageSlice from;                            // input
    ImageSlice to;                              // output
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels]
    uint n_images;
    uint n_pixels;  // of an image
    uint n_channels;
    uint dropout_key;  // what is dropped depends on it and on the place alone
    float dropout;     // share that is; 0: nothing
};

struct NormVjpParams {
    ImageSlice from;                            // input: what was normalised
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
    uint accumulate;  // 1: adds to what is there
};

struct ResampleParams {
    ImageSlice from;    // input
    ImageSlice to;      // output; in place for refine/pool_vjp
    ImageSlice pooled;  // input of refine/pool_vjp alone: what was pooled
    uint n_images;
    uint n_channels;
    uint rows;  // of the larger images
    uint columns;
    uint small_rows;  // of the smaller ones
    uint small_columns;
};

RELIDAR_SHARED_END
#endif
