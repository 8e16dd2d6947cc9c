// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels of the backward pass. These kernels trace the rays again, add
// the gradients of hits by surfel, and compute the gradients of poses. A gradient row
// belongs to one surfel of one instance.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_BACKWARD_H
#define RELIDAR_INCLUDED_DIFF_SHARED_BACKWARD_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_GATHER_BLOCK 32u  // number of hits that one thread sums
// Row number of an unused hit record. It is larger than all other row numbers, so that
// sorting moves unused records to the end.
#define RELIDAR_NO_ROW(n_rows) (n_rows)

/// Hit of a ray on a surfel (16 bytes). A later kernel sums the gradients of the surfel
/// from these records.
struct HitRecord {
    uint ray;  // index in the batch
    uint instance;
    float w;        // blending weight
    float d_alpha;  // dL/d(sigma G)
};
RELIDAR_DECLARE_POINTER(HitRecords, HitRecord);

struct BackwardParams {
    TraceScene scene;
    RenderedRays rendered;  // Input [n_rays]: results of the forward pass with the same scene.
    RayGradients upstream;  // input [n_rays] gradients of the blended values
    // Gradients [n_rows,16] of the 16 floats of each surfel, one row per surfel and
    // instance. The kernel adds to them.
    RELIDAR_OF(Floats, RecordGradients) d_records;
    RELIDAR_OF(Floats, Harmonics) d_sh;  // accumulated [n,3,16], if SH are evaluated per hit
    // Output [n]: 1 for surfels that get a gradient from at least one hit. Address 0 =
    // the kernel does not write the flags.
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // output [n_rays,6] d_origin, d_direction, or address 0
    RELIDAR_OF(Floats, DeviceRayGradients) d_rays;
    // Input [n_rays]: index in `hits` of the first hit of each ray. Used only if
    // gradients are summed without atomics (GradientReduction::gather).
    RELIDAR_OF(Uints, FirstHits) first_hit;
    HitRecords hits;                  // output [capacity] (gather)
    RELIDAR_OF(Uints, HitRows) rows;  // output [capacity] (gather)
    // Input [ceil(n/2),n_kept,2]: nearest n_kept hits of each of n rays, stored by the
    // forward pass. The hits of two rays alternate in memory.
    Hits kept;
    // Number of hits per ray that the forward pass has stored. The backward pass searches
    // for the remaining hits.
    uint n_kept;
    // Maximum number of hits in `hits`. The gradients of further hits are added with
    // atomics.
    uint capacity;
    uint n_rows;
    // 1: also computes the gradient of a small rotation of the viewing direction, which
    // pose gradients need. Adds its x, y, z to floats 7, 11 and 15 of the surfel's row in
    // `d_records`. Used only if spherical harmonics are evaluated per hit.
    uint with_turn;
};

/// Parameters of two kernels that sum the gradients of all hits on each surfel. Kernel
/// gather sums within blocks of hits. Kernel gather_heads then adds the sums of surfels
/// that have hits in several blocks.
struct GatherParams {
    TraceScene scene;
    RayGradients upstream;               // input [n_rays]
    HitRecords hits;                     // input [capacity]
    RELIDAR_OF(Uints, HitRows) rows;     // input [capacity] ascending
    RELIDAR_OF(Uints, HitSlots) slots;   // Input [capacity]: indices into `hits`, sorted by row.
    RELIDAR_OF(Uints, HitCount) n_hits;  // input [1], may exceed capacity
    // Hits are sorted by surfel and divided into blocks of RELIDAR_GATHER_BLOCK hits. If
    // a surfel has hits in several blocks, each block b stores its partial gradient sum
    // here, [n_blocks,2,k]: in [b,1] if the surfel's hits begin in this block, otherwise
    // in [b,0]. k is 16 floats, or 64 if SH are evaluated per hit.
    RELIDAR_OF(Floats, RowParts) parts;
    RELIDAR_OF(Floats, RecordGradients) d_records;  // accumulated [n_rows,16]
    RELIDAR_OF(Floats, Harmonics) d_sh;             // accumulated [n,3,16], if SH are evaluated per hit
    RELIDAR_OF(Uints, MostHits) most_hits;          // output [1]: maximum of n_hits over all launches
    uint capacity;
    uint n_rows;
};

struct PoseBlock {
    uint first_surfel;
    uint first_row;
    uint n_surfels;
    uint with_view;  // 1: this instance determines the view direction of the model's spherical harmonics.
};
RELIDAR_DECLARE_POINTER(PoseBlocks, PoseBlock);

// Number of floats of a pose gradient in the model frame: dL/d(translation),
// dL/d(rotation) about the model's origin, and dL/d(sensor position).
#define RELIDAR_POSE_SUMS 9

struct PoseBlocksParams {
    Records records;                                // input
    RELIDAR_OF(Floats, RecordGradients) d_records;  // input [n_rows,16]
    RELIDAR_OF(Floats, ViewGradients) d_view;       // input [n,3], if SH are evaluated per surfel
    PoseBlocks blocks;                              // input [n_blocks]
    RELIDAR_OF(Floats, PoseSums) sums;              // output [n_blocks,9]
    uint n_blocks;
    uint sh_per_surfel;
};

struct PosesParams {
    Instances instances;                // input
    RELIDAR_OF(Floats, PoseSums) sums;  // input [n_blocks,9]
    Uints first_block;                  // input [n_instances + 1]
    // Output [n_instances,6]: d_translation, d_rotation, in the world frame.
    RELIDAR_OF(Floats, InstancePoseGradients) d_poses;
    vec3 view_origin;  // world, m
    uint n_instances;
};

struct SensorPoseParams {
    Instances instances;                                // input
    RELIDAR_OF(Floats, InstancePoseGradients) d_poses;  // input [n_instances,6]
    // output [6] d_translation, d_rotation, in the world frame
    RELIDAR_OF(Floats, SensorPoseGradient) d_sensor;
    vec3 view_origin;  // sensor position in the world frame, m
    uint n_instances;
};

RELIDAR_SHARED_END
#endif
