// SPDX-License-Identifier: Apache-2.0
// Surfels as kernels see them: parameters (what is optimised) and records (what a hit
// reads), docs/method.md sections 2 and 4. Quaternions are w, x, y, z everywhere.
#ifndef RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#define RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#include "relidar/scene/surfels.h"

#define RELIDAR_LIST_STRETCH 16u  // rows of a thread of scene/list_touched

RELIDAR_SHARED_BEGIN

/// Parameters, gradients or moments of all surfels: one array a group.
struct SurfelPointers {
    RELIDAR_OF(Floats, Means) mean;                   // [n,3]
    RELIDAR_OF(Floats, Rotations) rotation;           // [n,4]
    RELIDAR_OF(Floats, LogScales) log_scale;          // [n,2]
    RELIDAR_OF(Floats, OpacityLogits) opacity_logit;  // [n]
    RELIDAR_OF(Floats, Harmonics) sh;                 // [n,3,16]
    RELIDAR_OF(Floats, ThirdLogScales) log_scale_w;   // [n] of 3D Gaussians, else address 0
    RELIDAR_OF(Floats, Gaits) gait;                   // [n,5] where actors bend, else address 0
};

/// Records of all surfels from their parameters (scene/activate.comp).
struct ActivateParams {
    SurfelPointers surfels;  // input
    Records records;         // output [n]
    Models models;           // input [n_models]
    Vec3s view_origins;      // input [n_models] where SH directions start, model frame, m (SH a surfel only)
    // input [n_models] turns, below 0 of models that are rigid; where there is a gait
    RELIDAR_OF(Floats, GaitPhases) phases;
    float alpha_min;  // surfels of lower opacity get opacity 0
    uint n_surfels;
    uint n_models;
    uint sh_degree;      // active degree 0..3
    uint sh_per_surfel;  // 1: evaluate channels here, 0: a hit does
};

/// Parameter gradients from record gradients (scene/activate_vjp.comp).
struct ActivateVjpParams {
    SurfelPointers surfels;                         // input
    RELIDAR_OF(Floats, RecordGradients) d_records;  // input [n_rows,16], laid out as SurfelRecord
    Models models;                                  // input [n_models]
    RELIDAR_OF(Uints, FurtherRows) more_rows;  // input first row of each further placement, model by model
    Vec3s view_origins;                        // input [n_models] as of the activation
    RELIDAR_OF(Floats, GaitPhases) phases;     // input [n_models] as of the activation
    SurfelPointers d_surfels;                  // output; sh is accumulated where SH are evaluated a hit
    // output [n] 1 where any record gradient is not zero; of listed surfels alone
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // input [n_listed] the surfels that may have a gradient, or address 0 = all
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // output [n,3] dL/d(view origin) by way of each surfel (SH a surfel only), or address
    // 0
    RELIDAR_OF(Floats, ViewGradients) d_view;
    uint n_surfels;
    uint n_models;
    uint sh_degree;
    uint sh_per_surfel;
    uint zero_untouched;  // 1: write zeros where touched is 0
};

/// Numbers of rows (scene/list_touched.comp).
struct ListTouchedParams {
    RELIDAR_OF(Uints, TouchedSurfels) touched;  // input [n_rows] 0 or 1
    RELIDAR_OF(Uints, TouchedRows) rows;        // output [n_rows] at most
    RELIDAR_OF(Uints, TouchedCount) count;      // in place [1], 0 before
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
