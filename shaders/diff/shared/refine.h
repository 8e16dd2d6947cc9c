// SPDX-License-Identifier: Apache-2.0
// Parameters of the ray-drop network's kernels that are not layers on images: matrix
// products, inputs and loss.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#define RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#include "layers.h"

#define RELIDAR_MATMUL_ROWS 8  // rows that a subgroup of network/matmul computes

RELIDAR_SHARED_BEGIN

// A matrix with strides, for C[b,h][i,j] = scale sum_k A[b,h][i,k] B[b,h][k,j].
struct MatrixView {
    Floats values;
    uint first;
    uint batch;  // stride from one b to the next
    uint head;   // stride from one h to the next
    uint row;
    uint column;
    uint unused;  // pads to 32 bytes, so that later fields have the same offset in C++ and GLSL
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
    // In place [n_rows, n]: softmax of each row. For the derivative: input, the softmax.
    RELIDAR_OF(Floats, SoftmaxValues) values;
    // In place [n_rows, n]: d_softmax is replaced by the derivative with respect to the
    // input of the softmax. Address 0: forward pass.
    RELIDAR_OF(Floats, SoftmaxGradients) d_values;
    uint n_rows;
    uint n;
};

struct DropLossParams {
    RELIDAR_OF(Floats, DropLogits) logit;   // input [n]
    RELIDAR_OF(Floats, StartLogits) start;  // input [n], added to logit, or address 0
    // Input [n] 1 dropped, 0 returned, negative: unknown. Address 0: all unknown.
    RELIDAR_OF(Floats, DropTargets) target;
    // Output [n] derivative of `weight` times the sum over the known pixels.
    RELIDAR_OF(Floats, DropLogitGradients) d_logit;
    RELIDAR_OF(Floats, DropProbabilities) probability;  // output [n], or address 0
    // Output [n_parts, 2] per part: sum of the cross-entropies, number of correct pixels.
    RELIDAR_OF(Floats, PartSums) partial;
    uint n;
    uint n_parts;
    float weight;  // weight per pixel
};

// Parameters of the kernel that assembles a batch of images from the samples on the
// device.
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
    uint n_fixed;  // number of last channels that belong to the sensor's pixels and are not rotated
    uint logit_channel;
    uint rows;
    uint columns;
};

RELIDAR_SHARED_END
#endif
