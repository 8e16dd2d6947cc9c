// SPDX-License-Identifier: Apache-2.0
// Parameters of the densification kernels (docs/method.md section 6). These kernels
// collect statistics, choose an action for each surfel, and move the surfels to their new
// rows.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_DENSIFY_H
#define RELIDAR_INCLUDED_DIFF_SHARED_DENSIFY_H
#include "relidar/base/lang.h"
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_DENSIFY_DROP 0  // pruned
#define RELIDAR_DENSIFY_KEEP 1
#define RELIDAR_DENSIFY_CLONE 2  // kept, and a copy is added next to it
#define RELIDAR_DENSIFY_SPLIT 3  // replaced by two smaller surfels

#define RELIDAR_DENSIFY_KEPT 0     // surfels that stay, including growing surfels
#define RELIDAR_DENSIFY_INVALID 1  // dropped: parameters not finite or invalid
#define RELIDAR_DENSIFY_FAINT 2    // dropped: opacity too small
#define RELIDAR_DENSIFY_LARGE 3    // dropped: scale too large
#define RELIDAR_DENSIFY_OUTSIDE 4  // dropped: outside the box of the actor
#define RELIDAR_DENSIFY_CLONES 5   // surfels that should be cloned
#define RELIDAR_DENSIFY_SPLITS 6   // surfels that should be split
#define RELIDAR_DENSIFY_WEIGHT 7   // sum of the weights of growing surfels
#define RELIDAR_DENSIFY_COUNTERS 8

struct ObserveParams {
    // Input [n,3]: gradient with respect to the mean position of each surfel. Undefined
    // if the surfel's entry of `touched` is 0.
    RELIDAR_OF(Floats, Means) d_mean;
    RELIDAR_OF(Uints, TouchedSurfels) touched;  // input [n]
    // Accumulated [n]: norm of each surfel's gradient dL/d(mean), summed over all
    // batches. One launch of the kernel adds the norms of one batch.
    RELIDAR_OF(Floats, GradientSums) gradient_sum;
    // Accumulated [n]: number of batches in which the surfel was visible, so that it got
    // a gradient. A batch with only some rays of a frame can miss the surfel. It also
    // counts if an earlier batch of the same frame gave the surfel a gradient.
    RELIDAR_OF(Uints, SeenBatches) n_seen;
    // Accumulated [n,n_words]: one bit per training frame. The bit is 1 if the surfel has
    // had a gradient in that frame.
    RELIDAR_OF(Uints, SeenFrames) frames;
    uint n_surfels;
    uint n_words;
    uint frame;          // frame of the batch
    uint is_full_frame;  // 1: the batch contains all rays of the frame.
};

struct ClassifyParams {
    SurfelPointers surfels;                         // input
    RELIDAR_OF(Floats, GradientSums) gradient_sum;  // input [n]
    RELIDAR_OF(Uints, SeenBatches) n_seen;          // input [n]
    RELIDAR_OF(Uints, DensifyActions) action;       // output [n] RELIDAR_DENSIFY_DROP ... SPLIT
    // Output [n]: a surfel's share of all new copies, as a relative weight. 0 if the
    // surfel is neither cloned nor split.
    RELIDAR_OF(Uints, GrowthWeights) weight;
    RELIDAR_OF(Uints, DensifyCounters) counters;  // accumulated [n_models,RELIDAR_DENSIFY_COUNTERS]
    Models models;                                // input [n_models]
    RELIDAR_OF(Floats, ModelExtents) extents;     // input [n_models] m
    float min_opacity;                            // surfels with a smaller opacity are dropped
    // Maximum scale relative to the model's extent. Surfels with a larger scale are
    // dropped.
    float max_extent_share;
    // Limit between small and large surfels, relative to the model's extent. A growing
    // surfel is cloned if it is small, and split if it is large.
    float clone_extent_share;
    float gradient_threshold;  // surfels whose mean gradient norm is larger grow
    uint n_surfels;
    uint n_models;
    uint key;  // key of the random numbers
};

struct AllotParams {
    RELIDAR_OF(Uints, GrowthWeights) weight;      // input [n]
    RELIDAR_OF(Uints, WeightsBefore) cumulative;  // input [n] sum of the preceding weights
    // Action of each surfel [n]. If a surfel should be cloned or split but gets no copy,
    // the kernel changes the action to KEEP.
    RELIDAR_OF(Uints, DensifyActions) action;
    // Output [n]: 0 if the surfel is dropped, otherwise 1 + the number of its copies.
    RELIDAR_OF(Uints, RowCounts) n_rows;
    uint n_surfels;
    uint n_new;
    uint total_weight;
    uint phase;  // 0 <= phase < total_weight
};

struct MoveParams {
    RELIDAR_OF(Uints, OldRows) from;           // input [n,stride] bits of any type
    RELIDAR_OF(Uints, NewRows) to;             // output [sum of n_rows,stride]
    RELIDAR_OF(Uints, DensifyActions) action;  // input [n]
    RELIDAR_OF(Uints, RowCounts) n_rows;       // input [n]
    RELIDAR_OF(Uints, RowStarts) starts;       // input [n] first new row of each surfel
    uint n_surfels;
    uint stride;
    // Initial values of copies of cloned surfels and of all parts of split surfels. 1
    // selects zeros (for Adam moments). 0 selects the values of the original surfel.
    uint zero_new;
};

struct SpawnParams {
    SurfelPointers surfels;                    // in place, in the new order
    RELIDAR_OF(Uints, DensifyActions) action;  // input [n] in the old order
    RELIDAR_OF(Uints, RowCounts) n_rows;       // input [n]
    RELIDAR_OF(Uints, RowStarts) starts;       // input [n]
    uint n_surfels;                            // number before densification
    uint key;
};

struct ResetOpacityParams {
    RELIDAR_OF(Floats, OpacityLogits) opacity_logit;  // in place [n]
    float max_logit;
    uint n_surfels;
};

RELIDAR_SHARED_END
#endif
