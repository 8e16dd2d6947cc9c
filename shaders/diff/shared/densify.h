// SPDX-License-Identifier: Apache-2.0
// Densification (docs/method.md section 6): statistics, what becomes of each surfel, and
// the move into the new order.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_DENSIFY_H
#define RELIDAR_INCLUDED_DIFF_SHARED_DENSIFY_H
#include "relidar/base/lang.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

// What becomes of a surfel.
#define RELIDAR_DENSIFY_DROP 0  // pruned
#define RELIDAR_DENSIFY_KEEP 1
#define RELIDAR_DENSIFY_CLONE 2  // stays, with a copy beside it
#define RELIDAR_DENSIFY_SPLIT 3  // replaced by two smaller ones

// Counters of a model, one uint each.
#define RELIDAR_DENSIFY_KEPT 0     // survivors, growing ones included
#define RELIDAR_DENSIFY_INVALID 1  // dropped: not finite, or no surfel at all
#define RELIDAR_DENSIFY_FAINT 2    // dropped: opacity
#define RELIDAR_DENSIFY_LARGE 3    // dropped: scale
#define RELIDAR_DENSIFY_OUTSIDE 4  // dropped: outside the box of the actor
#define RELIDAR_DENSIFY_CLONES 5   // wanted
#define RELIDAR_DENSIFY_SPLITS 6   // wanted
#define RELIDAR_DENSIFY_WEIGHT 7   // sum of weights
#define RELIDAR_DENSIFY_COUNTERS 8

/// One batch into the statistics (densify/observe.comp).
struct ObserveParams {
    // input [n,3] gradient with respect to the mean; undefined where not touched
    RELIDAR_OF(Floats, Means) d_mean;
    RELIDAR_OF(Uints, TouchedSurfels) touched;      // input [n]
    RELIDAR_OF(Floats, GradientSums) gradient_sum;  // accumulated [n] norms of the gradient
    RELIDAR_OF(Uints, SeenBatches) n_seen;          // accumulated [n] batches whose frame shows the surfel
    // accumulated [n,n_words] a bit a training frame: the surfel has had a gradient in it
    RELIDAR_OF(Uints, SeenFrames) frames;
    uint n_surfels;
    uint n_words;
    uint frame;        // of the batch
    uint whole_frame;  // 1: the batch holds all rays of the frame
};

/// What becomes of each surfel (densify/classify.comp).
struct ClassifyParams {
    SurfelPointers surfels;                         // input
    RELIDAR_OF(Floats, GradientSums) gradient_sum;  // input [n]
    RELIDAR_OF(Uints, SeenBatches) n_seen;          // input [n]
    RELIDAR_OF(Uints, DensifyActions) action;       // output [n] RELIDAR_DENSIFY_DROP ... SPLIT
    RELIDAR_OF(Uints, GrowthWeights) weight;      // output [n] share in the growth, 0 where it does not grow
    RELIDAR_OF(Uints, DensifyCounters) counters;  // accumulated [n_models,RELIDAR_DENSIFY_COUNTERS]
    Models models;                                // input [n_models]
    RELIDAR_OF(Floats, ModelExtents) extents;     // input [n_models] m
    float min_opacity;                            // below: dropped
    float max_extent_share;                       // scale over the model's extent above: dropped
    float clone_extent_share;  // max scale over the model's extent below: cloned, else split
    float gradient_threshold;  // mean norm above: grows
    uint n_surfels;
    uint n_models;
    uint key;  // of the random numbers
};

/// Hands n_new copies out by weight (densify/allot.comp).
struct AllotParams {
    RELIDAR_OF(Uints, GrowthWeights) weight;      // input [n]
    RELIDAR_OF(Uints, WeightsBefore) cumulative;  // input [n] sum of the weights before
    RELIDAR_OF(Uints, DensifyActions) action;     // in place [n] growing surfels that get nothing are kept
    RELIDAR_OF(Uints, RowCounts) n_rows;          // output [n] rows of each surfel afterwards
    uint n_surfels;
    uint n_new;
    uint total_weight;
    uint phase;  // 0 <= phase < total_weight
};

/// Rows of one array into their new places (densify/move.comp).
struct MoveParams {
    RELIDAR_OF(Uints, OldRows) from;           // input [n,stride] bits of any type
    RELIDAR_OF(Uints, NewRows) to;             // output [sum of n_rows,stride]
    RELIDAR_OF(Uints, DensifyActions) action;  // input [n]
    RELIDAR_OF(Uints, RowCounts) n_rows;       // input [n]
    RELIDAR_OF(Uints, RowStarts) starts;       // input [n] first new row of each
    uint n_surfels;
    uint stride;
    uint fresh;  // 1: rows of new surfels, and of those whose values change, are zero (moments)
};

/// Values of split surfels in their new places, which hold copies of the old ones
/// (densify/spawn.comp).
struct SpawnParams {
    SurfelPointers surfels;                    // in place, new order
    RELIDAR_OF(Uints, DensifyActions) action;  // input [n] old order
    RELIDAR_OF(Uints, RowCounts) n_rows;       // input [n]
    RELIDAR_OF(Uints, RowStarts) starts;       // input [n]
    uint n_surfels;                            // before
    uint key;
};

/// Opacity of all surfels (densify/reset_opacity.comp).
struct ResetOpacityParams {
    RELIDAR_OF(Floats, OpacityLogits) opacity_logit;  // in place [n]
    float max_logit;
    uint n_surfels;
};

RELIDAR_SHARED_END
#endif
