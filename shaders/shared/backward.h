// SPDX-License-Identifier: Apache-2.0
// Second cast and what follows from record gradients: gradients of poses.
#ifndef RELIDAR_INCLUDED_SHARED_BACKWARD_H
#define RELIDAR_INCLUDED_SHARED_BACKWARD_H
#include "trace.h"

RELIDAR_SHARED_BEGIN

struct BackwardParams {
    TraceScene scene;
    RenderedRays rendered;     // input [n_rays], of the forward pass with the same scene
    RayGradients upstream;     // input [n_rays]
    Floats d_records;          // accumulated [n_rows,16], rows as InstanceEntry counts them
    Floats d_sh;               // accumulated [n,3,16], where SH are evaluated a hit
    Floats d_rays;             // output [n_rays,6] d_origin, d_direction, or address 0
    uint with_turn;            // 1: d_records gets the turn of SH directions too, where SH are evaluated a hit
};

/// Consecutive surfels of one instance.
struct PoseBlock {
    uint first_surfel;
    uint first_row;
    uint n_surfels;
    uint with_view;   // 1: the placement from which the model is viewed
};
RELIDAR_POINTER(PoseBlocks, PoseBlock);

#define RELIDAR_POSE_SUMS 9   // force, torque about the model's origin, dL/d(view origin); model frame

struct PoseBlocksParams {
    Records records;       // input
    Floats d_records;      // input [n_rows,16]
    Floats d_view;         // input [n,3] where SH are evaluated once a surfel
    PoseBlocks blocks;     // input [n_blocks]
    Floats sums;           // output [n_blocks,9]
    uint n_blocks;
    uint sh_per_surfel;
};

struct PosesParams {
    Instances instances;   // input
    Floats sums;           // input [n_blocks,9]
    Uints first_block;     // input [n_instances + 1]
    Floats d_poses;        // output [n_instances,6] d_translation, d_rotation, world
    vec3 view_origin;      // world, m
    uint n_instances;
};

struct SensorPoseParams {
    Instances instances;   // input
    Floats d_poses;        // input [n_instances,6]
    Floats d_sensor;       // output [6] d_translation, d_rotation, world
    vec3 view_origin;      // world, m: the sensor's position
    uint n_instances;
};

RELIDAR_SHARED_END
#endif
