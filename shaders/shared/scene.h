// SPDX-License-Identifier: Apache-2.0
// Surfels as kernels see them: parameters (what is optimised) and records (what a hit reads), docs/method.md sections 2 and 4.
// Quaternions are w, x, y, z everywhere.
#ifndef RELIDAR_INCLUDED_SHARED_SCENE_H
#define RELIDAR_INCLUDED_SHARED_SCENE_H
#include "lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_SH_COEFFICIENTS 16
#define RELIDAR_SH_FLOATS 48

/// One surfel in its model's own frame, activated: 64 bytes, one cache line a hit. Never-hit surfels have opacity 0.
struct SurfelRecord {
    vec3 mean;         // m
    float opacity;     // sigma, 0..1
    vec3 axis_u;       // a_u / s_u, 1/m
    float intensity;   // channel values where SH are evaluated once a surfel
    vec3 axis_v;       // a_v / s_v, 1/m
    float hit_logit;
    vec3 normal;       // unit; of 3D Gaussians a_w / s_w, 1/m
    float drop_logit;
};
RELIDAR_POINTER(Records, SurfelRecord);

/// A model: a range of the scene's surfels. The table of models is in the order of their ranges, which hold all surfels.
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
    vec4 row0;            // model_from_world, rows of a 3x4 matrix
    vec4 row1;
    vec4 row2;
    uint first_surfel;    // of the model, in the scene's surfel arrays
    uint n_surfels;
    uint first_row;       // of its record gradients: a model's first placement has those of its surfels, others follow after all surfels
    uint unused;          // 64 bytes: a row is loaded in pieces of 16
};
RELIDAR_POINTER(Instances, InstanceEntry);

/// Parameters, gradients or moments of all surfels: one array a group.
struct SurfelPointers {
    Floats mean;            // [n,3]
    Floats rotation;        // [n,4]
    Floats log_scale;       // [n,2]
    Floats opacity_logit;   // [n]
    Floats sh;              // [n,3,16]
    Floats log_scale_w;     // [n] of 3D Gaussians, else address 0
};

/// Records of all surfels from their parameters (scene/activate.comp).
struct ActivateParams {
    SurfelPointers surfels;   // input
    Records records;          // output [n]
    Models models;            // input [n_models]
    Vec3s view_origins;       // input [n_models] where SH directions start, model frame, m (SH a surfel only)
    float alpha_min;          // surfels of lower opacity get opacity 0
    uint n_surfels;
    uint n_models;
    uint sh_degree;           // active degree 0..3
    uint sh_per_surfel;       // 1: evaluate channels here, 0: a hit does
};

/// Parameter gradients from record gradients (scene/activate_vjp.comp).
struct ActivateVjpParams {
    SurfelPointers surfels;     // input
    Floats d_records;           // input [n_rows,16], laid out as SurfelRecord
    Models models;              // input [n_models]
    Uints more_rows;            // input first row of each further placement, model by model
    Vec3s view_origins;         // input [n_models] as of the activation
    SurfelPointers d_surfels;   // output; sh is accumulated where SH are evaluated a hit
    Uints touched;              // output [n] 1 where any record gradient is not zero
    Floats d_view;              // output [n,3] dL/d(view origin) by way of each surfel (SH a surfel only), or address 0
    uint n_surfels;
    uint n_models;
    uint sh_degree;
    uint sh_per_surfel;
    uint zero_untouched;        // 1: write zeros where touched is 0
};

RELIDAR_SHARED_END
#endif
