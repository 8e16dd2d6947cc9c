// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels of the ray-drop network that are not in layers.h: matrix
// products, softmax, input images and loss.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#define RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#include "layers.h"

#define RELIDAR_MATMUL_ROWS 8  // Number of matrix rows that a subgroup of network/matmul computes.

RELIDAR_SHARED_BEGIN

// Batch of matrices in one array, with arbitrary distances between rows, columns and
// matrices.
struct MatrixView {
    Floats values;
    uint first;
    uint batch;  // Distance in floats between the matrices of two consecutive batch entries.
    uint head;   // Distance in floats between the matrices of two consecutive attention heads.
    uint row;
    uint column;
    // Pads the struct to 32 bytes, so that the fields after it have the same offset in
    // C++ and GLSL.
    uint unused;
};
struct MatmulParams {
    MatrixView a;  // input
    MatrixView b;  // input
    MatrixView c;  // output
    uint n_batch;
    uint n_heads;
    uint rows;  // rows of a and c
    uint inner;
    uint columns;  // columns of b and c
    float scale;
};

struct SoftmaxParams {
    // In place [n_rows, n]: input values, replaced by the softmax of each row. The
    // derivative reads the softmax from this array.
    RELIDAR_OF(Floats, SoftmaxValues) values;
    // [n_rows, n]: dL/d(softmax output), replaced in place by dL/d(softmax input). If the
    // address is 0, the kernel computes the softmax of `values` instead.
    RELIDAR_OF(Floats, SoftmaxGradients) d_values;
    uint n_rows;
    uint n;
};

struct DropLossParams {
    RELIDAR_OF(Floats, DropLogits) logit;   // input [n]
    RELIDAR_OF(Floats, StartLogits) start;  // input [n], added to logit, or address 0
    // Input [n]: measurement of each ray. 1 = no return, 0 = return, negative = unknown.
    // Address 0 = all rays are unknown.
    RELIDAR_OF(Floats, DropTargets) target;
    // Output [n]: derivative of the loss with respect to `logit`. The loss is `weight`
    // times the sum of the cross-entropies of all rays with a known measurement.
    RELIDAR_OF(Floats, DropLogitGradients) d_logit;
    RELIDAR_OF(Floats, DropProbabilities) probability;  // output [n], or address 0
    // Output [n_parts, 2]: for each part of the pixels, the sum of cross-entropies and
    // the number of correct predictions.
    RELIDAR_OF(Floats, PartSums) partial;
    uint n;
    uint n_parts;
    float weight;  // weight per pixel
};

struct DropInputsParams {
    RELIDAR_OF(Floats, DropSamples) samples;    // input [n_samples, channels, n_pixels] rendered values
    RELIDAR_OF(Floats, SampleTargets) targets;  // input [n_samples, n_pixels], or address 0
    RELIDAR_OF(Uints, ChosenSamples) chosen;    // input [n_images] index of the sample
    RELIDAR_OF(Uints, SampleTurns) turn;        // input [n_images] columns by which the scene is rotated
    Vec2s scale_shift;                          // input [channels] of the normalisation
    Floats images;                              // output [n_images, channels, n_pixels]
    // output [n_images, n_pixels] the rendered logit, not normalised
    RELIDAR_OF(Floats, StartLogits) start;
    RELIDAR_OF(Floats, DropTargets) target;  // output [n_images, n_pixels]
    uint n_images;
    uint n_channels;
    // The last n_fixed channels belong to the sensor instead of the scene. Data
    // augmentation rotates the scene but not these channels.
    uint n_fixed;
    uint logit_channel;
    uint rows;
    uint columns;
};

RELIDAR_SHARED_END
#endif
