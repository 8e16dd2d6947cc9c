// SPDX-License-Identifier: Apache-2.0
// Surfel records, models and instances in the layout that tracing kernels read from
// device memory (docs/method.md section 4).
#ifndef RELIDAR_INCLUDED_SCENE_SURFELS_H
#define RELIDAR_INCLUDED_SCENE_SURFELS_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_SH_COEFFICIENTS 16
#define RELIDAR_SH_FLOATS 48

/// Surfel as tracing kernels read it, in the frame of its model. It has 64 bytes, so that
/// a kernel reads one cache line per hit. Opacity 0 means that no ray hits it.
struct SurfelRecord {
    vec3 mean;      // Centre, metres.
    float opacity;  // Opacity sigma, 0..1.
    vec3 axis_u;    // First axis divided by its standard deviation, a_u / s_u, 1/m.
    // Intensity seen from the sensor. Set only with ShDirection::surfel, which evaluates
    // spherical harmonics once per surfel instead of once per ray. The same is true of
    // hit_logit and drop_logit. The softmax of these two is the drop probability.
    float intensity;
    vec3 axis_v;  // Second axis divided by its standard deviation, a_v / s_v, 1/m.
    float hit_logit;
    // For a surfel: its unit normal. For a 3D Gaussian: its third axis (unit vector a_w)
    // divided by the standard deviation s_w along this axis, in 1/m.
    vec3 normal;
    float drop_logit;
};
RELIDAR_DECLARE_POINTER(Records, SurfelRecord);

/// Contiguous range of surfels that form one model. The models are sorted by their
/// ranges. Every surfel belongs to exactly one range.
struct ModelEntry {
    uint first_surfel;
    uint n_surfels;
    vec3 half_size;       // Half size of the model's box, metres. 0 = the model has no box.
    float half_diagonal;  // Length of half_size, metres.
    uint first_more;      // Index of the model's second instance in the array `more_rows`.
    uint n_more;          // Number of instances of the model after the first one.
};
RELIDAR_DECLARE_POINTER(Models, ModelEntry);

/// Placement of a model in the world.
struct InstanceEntry {
    vec4 row0;  // First row of the matrix model_from_world (3 rows, 4 columns).
    vec4 row1;
    vec4 row2;
    uint first_surfel;  // Index of the model's first surfel in the surfel arrays of the scene.
    uint n_surfels;
    // First row of the instance in the array of gradients with respect to SurfelRecords.
    // The first instance of a model uses the rows of the model's surfels. Rows of further
    // instances are stored after the rows of all surfels.
    uint first_row;
    uint moves;  // 1 if the instance moves during the sweep, otherwise 0.
    // The next four fields are the motion of the model during the sweep, in the axes of
    // the model (docs/method.md section 4). model_from_world is the pose at time
    // middle_s. A ray at time t sees the model as it is after clamp(t - middle_s,
    // -half_span_s, half_span_s) seconds of this motion. The struct InstanceEntry has 96
    // bytes, because kernels load it in 16-byte pieces.
    vec3 velocity;   // Velocity, m/s.
    float middle_s;  // Middle of the motion interval, in seconds after the reference time of the sweep.
    vec3 turn_rate;  // Rotation vector per second, rad/s.
    float half_span_s;
};
RELIDAR_DECLARE_POINTER(Instances, InstanceEntry);

RELIDAR_SHARED_END
#endif
