// SPDX-License-Identifier: Apache-2.0
// Parameters of the layers of the ray-drop network: convolution, normalisation and change
// of image size. Images are [n_images, channels, rows, columns]. Neighbouring columns are
// adjacent in memory. Rows end at the sensor's field of view. If `circular` is 1, columns
// wrap around, because the image covers a full turn. Otherwise they end like rows.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#define RELIDAR_INCLUDED_DIFF_SHARED_LAYERS_H
#include "images.h"

#define RELIDAR_CONV_OUT 8  // Number of output channels that a subgroup of a convolution kernel computes.
// Number of input channels that convolution kernels process together.
#define RELIDAR_CONV_IN 8
// Number of pixels of a channel that one thread of the normalisation kernels computes.
#define RELIDAR_NORM_PIXELS 8

RELIDAR_SHARED_BEGIN

struct ConvParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice to;    // output, or accumulated [n_images, n_out, rows, columns]
    // Input [n_out,n_in,TAPS]. If `transposed` is 1, [n_in,n_out,TAPS].
    RELIDAR_OF(Floats, ConvWeights) weights;
    RELIDAR_OF(Floats, ConvBias) bias;  // input [n_out], or address 0
    uint n_images;
    uint rows;
    uint columns;
    uint n_in;
    uint n_out;
    // 1: computes the derivative with respect to the input. Input and output channels are
    // exchanged, and the 3x3 kernels are mirrored.
    uint transposed;
    uint accumulate;  // 1: adds the result to the stored values instead of overwriting them.
    uint circular;
};

struct ConvWeightsParams {
    ImageSlice from;  // input [n_images, n_in, rows, columns]
    ImageSlice d_to;  // input [n_images, n_out, rows, columns]
    // Output [n_parts, n_out, n_in, TAPS]: gradient of the weights, summed over the image
    // rows of each part.
    RELIDAR_OF(Floats, PartSums) partial;
    uint n_images;
    uint rows;
    uint columns;
    uint n_in;
    uint n_out;
    uint n_parts;
    uint circular;
};

struct SumPartsParams {
    RELIDAR_OF(Floats, PartSums) partial;  // input [n_parts, n]
    RELIDAR_OF(Floats, SumOfParts) sum;    // output [n]
    uint n_parts;
    uint n;
};

struct ChannelSumsParams {
    ImageSlice from;  // input
    ImageSlice d_to;  // input, for kNormVjpSums: gradient of the output of network/norm
    // Output [n_parts, channels, 2], or [n_parts, channels] for kPlainSums.
    RELIDAR_OF(Floats, PartSums) partial;
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels], for kNormVjpSums
    RELIDAR_OF(Vec2s, NormMoments) moments;     // input [channels], for kNormVjpSums
    uint kind;
    uint n_images;
    uint n_pixels;  // pixels per image
    uint n_channels;
    // Number of parts into which the images are divided for the sums. It is a multiple of
    // n_images, so that no part extends over two images.
    uint n_parts;
    uint dropout_key;
    float dropout;
};
#ifdef __cplusplus
// Values of ChannelSumsParams::kind. kMomentSums selects, for batch normalisation, the
// mean and the sum of squared deviations of the pixels in each part of an image.
constexpr uint kMomentSums = 0;
constexpr uint kNormVjpSums = 1;  // selects the gradients dL/d(beta), dL/d(gamma)
constexpr uint kPlainSums = 2;    // selects plain sums, which are the gradient of a bias
#else
const uint kMomentSums = 0u, kNormVjpSums = 1u, kPlainSums = 2u;
#endif

struct NormFinishParams {
    RELIDAR_OF(Floats, PartSums) partial;     // input [n_parts, channels, 2] of kMomentSums
    RELIDAR_OF(Vec2s, BetaGamma) beta_gamma;  // input [channels]
    // In-place array [channels]: running mean and variance of each channel. Each training
    // batch updates them. Evaluation (`training` is 0) normalises with them.
    RELIDAR_OF(Vec2s, RunningMoments) running;
    RELIDAR_OF(Vec2s, NormMoments) moments;  // output [channels] mean and 1 / deviation
    // Output [channels]: factors that replace normalisation, gamma and beta by one
    // operation, scale * x + shift.
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;
    uint n_channels;
    uint n_parts;  // parts of all images
    uint n_images;
    uint n_pixels;  // pixels per image
    uint training;
    float momentum;  // Weight of the current batch in the update of the running mean and variance.
    float epsilon;
};

struct NormParams {
    ImageSlice from;                            // input
    ImageSlice to;                              // output
    RELIDAR_OF(Vec2s, ScaleShift) scale_shift;  // input [channels]
    uint n_images;
    uint n_pixels;  // pixels per image
    uint n_channels;
    // Seed of the dropout mask. Only this seed and the index of a value determine whether
    // the value is dropped.
    uint dropout_key;
    float dropout;  // Share of values that dropout sets to 0. 0 means no dropout.
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
    uint accumulate;  // 1: adds the result to the stored values instead of overwriting them.
};

struct ResampleParams {
    ImageSlice from;  // input
    ImageSlice to;    // output; in place for network/pool_vjp
    // Image to which max pooling was applied. Used only by network/pool_vjp.
    ImageSlice pooled;
    uint n_images;
    uint n_channels;
    uint rows;  // size of the larger images
    uint columns;
    uint small_rows;  // size of the smaller images
    uint small_columns;
    uint circular;
};

RELIDAR_SHARED_END
#endif
