// SPDX-License-Identifier: Apache-2.0
// The second cast, sums of its hit records by surfel, and what follows from them:
// gradients of poses.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BACKWARD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BACKWARD_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_GATHER_BLOCK 32u         // hits a thread sums
#define RELIDAR_NO_ROW(n_rows) (n_rows)  // row of a slot without a gradient: behind all others when sorted

/// A blended hit of which the rest is computed again: 16 bytes.
struct HitRecord {
    uint ray;  // of the batch
    uint instance;
    float w;        // blending weight
    float d_alpha;  // dL/d(sigma G)
};
RELIDAR_POINTER(HitRecords, HitRecord);

struct BackwardParams {
    TraceScene scene;
    RenderedRays rendered;  // input [n_rays], of the forward pass with the same scene
    RayGradients upstream;  // input [n_rays]
    // accumulated [n_rows,16], rows as InstanceEntry counts them
    RELIDAR_OF(Floats, RecordGradients) d_records;
    RELIDAR_OF(Floats, Harmonics) d_sh;  // accumulated [n,3,16], where SH are evaluated a hit
    // output [n] 1 at surfels that a hit with a gradient is of, or address 0
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    RELIDAR_OF(Floats, DeviceRayGradients) d_rays;  // output [n_rays,6] d_origin, d_direction, or address 0
    RELIDAR_OF(Uints, FirstHits) first_hit;         // input [n_rays] slot of each ray's first hit (gather)
    HitRecords hits;                                // output [capacity] (gather)
    RELIDAR_OF(Uints, HitRows) rows;                // output [capacity] (gather)
    Hits kept;      // input [ceil(n/2),n_kept,2] of n threads, as the forward pass blended them
    uint n_kept;    // what a ray has behind them is searched again
    uint capacity;  // hits in slots beyond it are added with atomics
    uint n_rows;
    uint with_turn;  // 1: d_records gets the turn of SH directions too, where SH are evaluated a hit
};

/// Sums of hit records by row: gather, then gather_heads for rows that go on in later
/// blocks.
struct GatherParams {
    TraceScene scene;
    RayGradients upstream;               // input [n_rays]
    HitRecords hits;                     // input [capacity]
    RELIDAR_OF(Uints, HitRows) rows;     // input [capacity] ascending
    RELIDAR_OF(Uints, HitSlots) slots;   // input [capacity] of `hits`, in the order of rows
    RELIDAR_OF(Uints, HitCount) n_hits;  // input [1], may exceed capacity
    // [blocks,2,16 or 64] sums of what a block has of a row that began earlier, and of
    // one that goes on
    RELIDAR_OF(Floats, RowParts) parts;
    RELIDAR_OF(Floats, RecordGradients) d_records;  // accumulated [n_rows,16]
    RELIDAR_OF(Floats, Harmonics) d_sh;             // accumulated [n,3,16], where SH are evaluated a hit
    RELIDAR_OF(Uints, MostHits) most_hits;          // maximum [1] of n_hits
    uint capacity;
    uint n_rows;
};

/// Consecutive surfels of one instance.
struct PoseBlock {
    uint first_surfel;
    uint first_row;
    uint n_surfels;
    uint with_view;  // 1: the placement from which the model is viewed
};
RELIDAR_POINTER(PoseBlocks, PoseBlock);

#define RELIDAR_POSE_SUMS 9  // force, torque about the model's origin, dL/d(view origin); model frame

struct PoseBlocksParams {
    Records records;                                // input
    RELIDAR_OF(Floats, RecordGradients) d_records;  // input [n_rows,16]
    RELIDAR_OF(Floats, ViewGradients) d_view;       // input [n,3] where SH are evaluated once a surfel
    PoseBlocks blocks;                              // input [n_blocks]
    RELIDAR_OF(Floats, PoseSums) sums;              // output [n_blocks,9]
    uint n_blocks;
    uint sh_per_surfel;
};

struct PosesParams {
    Instances instances;                // input
    RELIDAR_OF(Floats, PoseSums) sums;  // input [n_blocks,9]
    Uints first_block;                  // input [n_instances + 1]
    // output [n_instances,6] d_translation, d_rotation, world
    RELIDAR_OF(Floats, InstancePoseGradients) d_poses;
    vec3 view_origin;  // world, m
    uint n_instances;
};

struct SensorPoseParams {
    Instances instances;                                // input
    RELIDAR_OF(Floats, InstancePoseGradients) d_poses;  // input [n_instances,6]
    RELIDAR_OF(Floats, SensorPoseGradient) d_sensor;    // output [6] d_translation, d_rotation, world
    vec3 view_origin;                                   // world, m: the sensor's position
    uint n_instances;
};

RELIDAR_SHARED_END
#endif
