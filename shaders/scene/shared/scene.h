// SPDX-License-Identifier: Apache-2.0
// Data of surfels in kernels: parameters, which are optimised, and records, which are
// read for each hit (docs/method.md sections 2 and 4). Quaternions are w, x, y, z
// everywhere.
#ifndef RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#define RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#include "relidar/scene/surfels.h"

#define RELIDAR_LIST_STRETCH 16u  // rows for each thread of scene/list_touched

RELIDAR_SHARED_BEGIN

/// Parameters, gradients or moments of all surfels, with an array for each parameter
/// group.
struct SurfelPointers {
    RELIDAR_OF(Floats, Means) mean;                   // [n,3]
    RELIDAR_OF(Floats, Rotations) rotation;           // [n,4]
    RELIDAR_OF(Floats, LogScales) log_scale;          // [n,2]
    RELIDAR_OF(Floats, OpacityLogits) opacity_logit;  // [n]
    RELIDAR_OF(Floats, Harmonics) sh;                 // [n,3,16]
    RELIDAR_OF(Floats, ThirdLogScales) log_scale_w;   // [n] for 3D Gaussians, otherwise address 0
    RELIDAR_OF(Floats, Gaits) gait;                   // [n,5] if actors deform, otherwise address 0
};

/// Computes the records of all surfels from their parameters (scene/activate.comp).
struct ActivateParams {
    SurfelPointers surfels;  // input
    Records records;         // output [n]
    Models models;           // input [n_models]
    // input [n_models] origins of SH directions, model frame, m (only if SH are evaluated
    // per surfel)
    Vec3s view_origins;
    // input [n_models] phases in turns, below 0 for rigid models; only used with a gait
    RELIDAR_OF(Floats, GaitPhases) phases;
    float alpha_min;  // surfels with a lower opacity get opacity 0
    uint n_surfels;
    uint n_models;
    uint sh_degree;      // active degree 0..3
    uint sh_per_surfel;  // 1: SH channels are evaluated once for each surfel, here; 0: at each hit
};

/// Computes parameter gradients from record gradients (scene/activate_vjp.comp).
struct ActivateVjpParams {
    SurfelPointers surfels;                         // input
    RELIDAR_OF(Floats, RecordGradients) d_records;  // input [n_rows,16] in the layout of SurfelRecord
    Models models;                                  // input [n_models]
    // input: first row of each additional placement, model by model
    RELIDAR_OF(Uints, FurtherRows) more_rows;
    Vec3s view_origins;                     // input [n_models] same as for the activation
    RELIDAR_OF(Floats, GaitPhases) phases;  // input [n_models] same as for the activation
    SurfelPointers d_surfels;               // output; sh is accumulated if SH are evaluated at each hit
    // output [n] 1 if a record gradient is not zero; written only for listed surfels
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // input [n_listed] surfels that may have a gradient; address 0 = all
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // output [n,3] dL/d(view origin) through each surfel (only if SH are evaluated per
    // surfel), or address 0
    RELIDAR_OF(Floats, ViewGradients) d_view;
    uint n_surfels;
    uint n_models;
    uint sh_degree;
    uint sh_per_surfel;
    uint zero_untouched;  // 1: write zeros if touched is 0
};

/// Lists the rows with a gradient (scene/list_touched.comp).
struct ListTouchedParams {
    RELIDAR_OF(Uints, TouchedSurfels) touched;  // input [n_rows] 0 or 1
    RELIDAR_OF(Uints, TouchedRows) rows;        // output, at most [n_rows]
    RELIDAR_OF(Uints, TouchedCount) count;      // in place [1], 0 before
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
