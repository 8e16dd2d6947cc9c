// SPDX-License-Identifier: Apache-2.0
// Densification (docs/method.md section 6): statistics, what becomes of each surfel, and the move into the new order.
#ifndef RELIDAR_INCLUDED_SHARED_DENSIFY_H
#define RELIDAR_INCLUDED_SHARED_DENSIFY_H
#include "relidar/shared/lang.h"
#include "scene.h"

RELIDAR_SHARED_BEGIN

// What becomes of a surfel.
#define RELIDAR_DENSIFY_DROP 0    // pruned
#define RELIDAR_DENSIFY_KEEP 1
#define RELIDAR_DENSIFY_CLONE 2   // stays, with a copy beside it
#define RELIDAR_DENSIFY_SPLIT 3   // replaced by two smaller ones
#define RELIDAR_DENSIFY_SHARE 4   // stays, with copies; all of them together are as opaque as it was

// Counters of a model, one uint each.
#define RELIDAR_DENSIFY_KEPT 0      // survivors, growing ones included
#define RELIDAR_DENSIFY_INVALID 1   // dropped: not finite, or no surfel at all
#define RELIDAR_DENSIFY_FAINT 2     // dropped: opacity
#define RELIDAR_DENSIFY_LARGE 3     // dropped: scale
#define RELIDAR_DENSIFY_OUTSIDE 4   // dropped: outside the box of the actor
#define RELIDAR_DENSIFY_CLONES 5    // wanted
#define RELIDAR_DENSIFY_SPLITS 6    // wanted
#define RELIDAR_DENSIFY_WEIGHT 7    // sum of weights
#define RELIDAR_DENSIFY_COUNTERS 8

// What makes a surfel grow.
#define RELIDAR_DENSIFY_BY_NOTHING 0
#define RELIDAR_DENSIFY_BY_GRADIENT 1
#define RELIDAR_DENSIFY_BY_OPACITY 2

/// One batch into the statistics (densify/observe.comp).
struct ObserveParams {
    Floats d_mean;         // input [n,3] gradient with respect to the mean; undefined where not touched
    Uints touched;         // input [n]
    Floats gradient_sum;   // accumulated [n] norms of the gradient
    Uints n_seen;          // accumulated [n] batches whose frame shows the surfel
    Uints frames;          // accumulated [n,n_words] a bit a training frame: the surfel has had a gradient in it
    uint n_surfels;
    uint n_words;
    uint frame;            // of the batch
    uint whole_frame;      // 1: the batch holds all rays of the frame
};

/// What becomes of each surfel (densify/classify.comp).
struct ClassifyParams {
    SurfelPointers surfels;     // input
    Floats gradient_sum;        // input [n]
    Uints n_seen;               // input [n]
    Uints action;               // output [n] RELIDAR_DENSIFY_DROP ... SHARE
    Uints weight;               // output [n] share in the growth, 0 where it does not grow
    Uints counters;             // accumulated [n_models,RELIDAR_DENSIFY_COUNTERS]
    Models models;              // input [n_models]
    Floats extents;             // input [n_models] m
    float min_opacity;          // below: dropped
    float max_extent_share;     // scale over the model's extent above: dropped
    float clone_extent_share;   // max scale over the model's extent below: cloned, else split
    float gradient_threshold;   // mean norm above: grows
    uint growth;                // RELIDAR_DENSIFY_BY_*
    uint bounded;               // 1: outside the box of the model: dropped
    uint n_surfels;
    uint n_models;
    uint key;                   // of the random numbers
};

/// Hands n_new copies out by weight (densify/allot.comp).
struct AllotParams {
    Uints weight;       // input [n]
    Uints cumulative;   // input [n] sum of the weights before
    Uints action;       // in place [n] growing surfels that get nothing are kept
    Uints n_rows;       // output [n] rows of each surfel afterwards
    uint n_surfels;
    uint n_new;
    uint total_weight;
    uint phase;         // 0 <= phase < total_weight
};

/// Rows of one array into their new places (densify/move.comp).
struct MoveParams {
    Uints from;      // input [n,stride] bits of any type
    Uints to;        // output [sum of n_rows,stride]
    Uints action;    // input [n]
    Uints n_rows;    // input [n]
    Uints starts;    // input [n] first new row of each
    uint n_surfels;
    uint stride;
    uint fresh;      // 1: rows of new surfels, and of those whose values change, are zero (moments)
};

/// Values of split and shared surfels in their new places, which hold copies of the old ones (densify/spawn.comp).
struct SpawnParams {
    SurfelPointers surfels;   // in place, new order
    Uints action;             // input [n] old order
    Uints n_rows;             // input [n]
    Uints starts;             // input [n]
    float min_opacity;        // shared surfels do not go below
    uint n_surfels;           // before
    uint key;
};

/// Opacity of all surfels (densify/reset_opacity.comp).
struct ResetOpacityParams {
    Floats opacity_logit;   // in place [n]
    float max_logit;
    uint n_surfels;
};

/// Noise on the means (densify/jitter.comp).
struct JitterParams {
    SurfelPointers surfels;   // means in place
    float amount;             // standard deviation, in scales of the surfel
    uint n_surfels;
    uint key;
};

RELIDAR_SHARED_END
#endif
