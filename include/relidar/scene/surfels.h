// SPDX-License-Identifier: Apache-2.0
// Surfel records, models and instances on a device, as tracing kernels read them
// (docs/method.md section 4).
#ifndef RELIDAR_INCLUDED_SCENE_SURFELS_H
#define RELIDAR_INCLUDED_SCENE_SURFELS_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_SH_COEFFICIENTS 16
#define RELIDAR_SH_FLOATS 48

/// Activated surfel in the frame of its model. It has 64 bytes, so that a hit reads
/// one cache line. Surfels that cannot be hit have opacity 0.
struct SurfelRecord {
    vec3 mean;        // Centre, metres.
    float opacity;    // Opacity sigma, 0..1.
    vec3 axis_u;      // First axis divided by its standard deviation, a_u / s_u, 1/m.
    float intensity;  // Intensity; this and the two logits are used if SH are evaluated once per surfel.
    vec3 axis_v;      // Second axis divided by its standard deviation, a_v / s_v, 1/m.
    float hit_logit;
    vec3 normal;  // Unit normal of a surfel; a_w / s_w in 1/m for 3D Gaussians.
    float drop_logit;
};
RELIDAR_POINTER(Records, SurfelRecord);

/// Model: a range of the surfels of a scene. The table of models is in the order of these
/// ranges, which together contain all surfels.
struct ModelEntry {
    uint first_surfel;
    uint n_surfels;
    vec3 half_size;       // Half size of the model's box, metres; 0 = unbounded.
    float half_diagonal;  // Length of half_size.
    uint first_more;      // Index in more_rows of the model's second instance.
    uint n_more;          // Number of instances after the first one.
};
RELIDAR_POINTER(Models, ModelEntry);

/// Instance: placement of a model in the world.
struct InstanceEntry {
    vec4 row0;  // First row of the 3x4 matrix model_from_world.
    vec4 row1;
    vec4 row2;
    uint first_surfel;  // First surfel of the model in the surfel arrays of the scene.
    uint n_surfels;
    // First row of the instance's record gradients. The first instance of a model uses
    // the rows of its surfels. The rows of further instances follow after all surfels.
    uint first_row;
    uint moves;  // 1 if the motion below is not zero.
    // Motion of the model during the sweep, in the axes of the model (docs/method.md
    // section 4). A ray fired at time t meets the model at its position clamp(t -
    // middle_s, -half_span_s, half_span_s) after model_from_world. The struct has 96
    // bytes, because kernels load it in 16-byte pieces.
    vec3 velocity;   // Velocity, m/s.
    float middle_s;  // Middle of the motion, in seconds after the reference time of the sweep.
    vec3 turn_rate;  // Turn rate: rotation vector per second.
    float half_span_s;
};
RELIDAR_POINTER(Instances, InstanceEntry);

RELIDAR_SHARED_END
#endif
