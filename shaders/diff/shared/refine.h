// SPDX-License-Identifier: Apache-2.0
// The ray-drop network beside its layers on images: products of matrices, inputs and
// loss.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#define RELIDAR_INCLUDED_DIFF_SHARED_REFINE_H
#include "layers.h"

#define RELIDAR_MATMUL_ROWS 8  // that a subgroup of refine/matmul makes

RELIDAR_SHARED_BEGIN

// C[b,h][i,j] = scale sum_k A[b,h][i,k] B[b,h][k,j], every matrix by its strides
struct MatrixView {
    Floats values;
    uint first;
    uint batch;  // stride from one b to the next
    uint head;   // stride from one h to the next
    uint row;
    uint column;
    uint unused;  // 32 bytes: what follows lies at the same place in C++ and GLSL
};
struct MatmulParams {
    MatrixView a;  // input
    MatrixView b;  // input
    MatrixView c;  // output
    uint n_batch;
    uint n_heads;
    uint rows;  // of a and c
    uint inner;
    uint columns;  // of b and c
    float scale;
};

struct SoftmaxParams {
    // in place [n_rows, n]: softmax of each row; vjp: input, the softmax
    RELIDAR_OF(Floats, SoftmaxValues) values;
    // in place [n_rows, n]: d_softmax becomes the derivative by what it was taken of;
    // else address 0
    RELIDAR_OF(Floats, SoftmaxGradients) d_values;
    uint n_rows;
    uint n;
};

struct DropLossParams {
    RELIDAR_OF(Floats, DropLogits) logit;   // input [n]
    RELIDAR_OF(Floats, StartLogits) start;  // input [n], or address 0: added to logit
    // input [n] 1 dropped, 0 returned, negative: not known; address 0: none is
    RELIDAR_OF(Floats, DropTargets) target;
    // output [n] derivative of `weight` times the sum over known pixels
    RELIDAR_OF(Floats, DropLogitGradients) d_logit;
    RELIDAR_OF(Floats, DropProbabilities) probability;  // output [n], or address 0
    // output [n_parts, 2] sum of the cross-entropies of a part, and pixels that are right
    RELIDAR_OF(Floats, PartSums) partial;
    uint n;
    uint n_parts;
    float weight;  // of a pixel
};

// A batch of images from the samples that are kept on the device.
struct DropInputsParams {
    RELIDAR_OF(Floats, DropSamples) samples;    // input [n_samples, channels, n_pixels] as they were rendered
    RELIDAR_OF(Floats, SampleTargets) targets;  // input [n_samples, n_pixels], or address 0
    RELIDAR_OF(Uints, ChosenSamples) chosen;    // input [n_images] sample
    RELIDAR_OF(Uints, SampleTurns) turn;        // input [n_images] columns by which what is seen moves
    Vec2s scale_shift;                          // input [channels] of the normalisation
    Floats images;                              // output [n_images, channels, n_pixels]
    RELIDAR_OF(Floats, StartLogits) start;      // output [n_images, n_pixels] the rendered logit, as it is
    RELIDAR_OF(Floats, DropTargets) target;     // output [n_images, n_pixels]
    uint n_images;
    uint n_channels;
    uint n_fixed;  // channels, the last ones, that belong to the sensor's pixels and do not move
    uint logit_channel;
    uint rows;
    uint columns;
};

RELIDAR_SHARED_END
#endif
