// SPDX-License-Identifier: Apache-2.0
// Surfels and placed models on a device, as tracing kernels read them (docs/method.md
// section 4).
#ifndef RELIDAR_INCLUDED_SCENE_SURFELS_H
#define RELIDAR_INCLUDED_SCENE_SURFELS_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_SH_COEFFICIENTS 16
#define RELIDAR_SH_FLOATS 48

/// One surfel in its model's own frame, activated: 64 bytes, one cache line a hit.
/// Never-hit surfels have opacity 0.
struct SurfelRecord {
    vec3 mean;        // m
    float opacity;    // sigma, 0..1
    vec3 axis_u;      // a_u / s_u, 1/m
    float intensity;  // channel values where SH are evaluated once a surfel
    vec3 axis_v;      // a_v / s_v, 1/m
    float hit_logit;
    vec3 normal;  // unit; of 3D Gaussians a_w / s_w, 1/m
    float drop_logit;
};
RELIDAR_POINTER(Records, SurfelRecord);

/// A model: a range of the scene's surfels. The table of models is in the order of their
/// ranges, which hold all surfels.
struct ModelEntry {
    uint first_surfel;
    uint n_surfels;
    vec3 half_size;       // of its box, m; 0 = unbounded
    float half_diagonal;  // length of half_size
    uint first_more;      // entry of more_rows of its second placement
    uint n_more;          // placements after the first one
};
RELIDAR_POINTER(Models, ModelEntry);

/// A model placed in the world.
struct InstanceEntry {
    vec4 row0;  // model_from_world, rows of a 3x4 matrix
    vec4 row1;
    vec4 row2;
    uint first_surfel;  // of the model, in the scene's surfel arrays
    uint n_surfels;
    // of its record gradients: a model's first placement has those of its surfels, others
    // follow after all surfels
    uint first_row;
    uint moves;  // 1: what follows is not zero
    // How the model moves during the sweep, in its own axes (docs/method.md section 4). A
    // ray that is fired at time t meets the model clamp(t - middle_s, -half_span_s,
    // half_span_s) after it was at model_from_world. 96 bytes: a row is loaded in pieces
    // of 16.
    vec3 velocity;   // m/s
    float middle_s;  // from the sweep's reference time
    vec3 turn_rate;  // rotation vector per second
    float half_span_s;
};
RELIDAR_POINTER(Instances, InstanceEntry);

RELIDAR_SHARED_END
#endif
