// SPDX-License-Identifier: Apache-2.0
// Memory layout of surfels in kernels. The optimizer changes the parameters of a surfel.
// Tracing kernels read the record of a surfel, which is computed from its parameters.
// Quaternions are stored as w, x, y, z.
#ifndef RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#define RELIDAR_INCLUDED_SCENE_SHARED_SCENE_H
#include "relidar/scene/surfels.h"

#define RELIDAR_LIST_STRETCH 16u  // Number of rows that each thread of scene/list_touched checks.

RELIDAR_SHARED_BEGIN

/// Addresses of the parameter arrays of all surfels. Also used for arrays of the same
/// layout: gradients and Adam moments.
struct SurfelPointers {
    RELIDAR_OF(Floats, Means) mean;                   // [n,3]
    RELIDAR_OF(Floats, Rotations) rotation;           // [n,4]
    RELIDAR_OF(Floats, LogScales) log_scale;          // [n,2]
    RELIDAR_OF(Floats, OpacityLogits) opacity_logit;  // [n]
    RELIDAR_OF(Floats, Harmonics) sh;                 // [n,3,16]
    RELIDAR_OF(Floats, ThirdLogScales) log_scale_w;   // [n] for 3D Gaussians, otherwise address 0
    RELIDAR_OF(Floats, Gaits) gait;                   // [n,5] if actors deform, otherwise address 0
};

/// Parameters of scene/activate.comp, which computes the records of all surfels from
/// their parameters.
struct ActivateParams {
    SurfelPointers surfels;  // input
    Records records;         // output [n] records that tracing kernels read
    Models models;           // input [n_models]
    // Input [n_models]: position of the sensor in the model frame, m. If sh_per_surfel is
    // 1, the spherical harmonics (SH) of a surfel are evaluated in the direction from
    // this point to the surfel.
    Vec3s view_origins;
    // Input [n_models]: phase of the model's walking motion (gait), 0 to 1. Negative for
    // rigid models.
    RELIDAR_OF(Floats, GaitPhases) phases;
    float alpha_min;  // surfels whose opacity is lower get opacity 0
    uint n_surfels;
    uint n_models;
    uint sh_degree;  // active degree 0..3
    // 1: this kernel evaluates the spherical harmonics (SH) once per surfel. 0: tracing
    // kernels evaluate the SH at each hit.
    uint sh_per_surfel;
};

/// Parameters of scene/activate_vjp.comp, which converts gradients of the surfel records
/// (SurfelRecord) to gradients of the surfel parameters.
struct ActivateVjpParams {
    SurfelPointers surfels;                         // input
    RELIDAR_OF(Floats, RecordGradients) d_records;  // input [n_rows,16] in the layout of SurfelRecord
    Models models;                                  // input [n_models]
    // Input: `d_records` has one row per surfel and instance. The first instance of a
    // model uses row i for surfel i. For each further instance, this is its first row.
    // The further instances are sorted by model.
    RELIDAR_OF(Uints, FurtherRows) more_rows;
    Vec3s view_origins;                     // input [n_models] same as for the activation
    RELIDAR_OF(Floats, GaitPhases) phases;  // input [n_models] same as for the activation
    // Output: gradients of the parameters. If spherical harmonics are evaluated at each
    // hit, their gradients are missing here, because the tracing kernels write them.
    SurfelPointers d_surfels;
    // Output [n]: 1 if the gradient of the surfel's record is not zero. Written only for
    // the surfels in the list `rows`.
    RELIDAR_OF(Uints, TouchedSurfels) touched;
    // Input [n_listed]: indices of the surfels that may have a gradient. Address 0 = all
    // surfels are processed.
    RELIDAR_OF(Uints, TouchedRows) rows;
    RELIDAR_OF(Uints, TouchedCount) n_listed;  // input [1]
    // Output [n,3]: contribution of each surfel to dL/d(sensor position). Not written if
    // the address is 0. Used only if spherical harmonics are evaluated per surfel.
    RELIDAR_OF(Floats, ViewGradients) d_view;
    uint n_surfels;
    uint n_models;
    uint sh_degree;
    uint sh_per_surfel;
    uint zero_untouched;  // 1: writes zero gradients for surfels whose record gradient is zero.
};

/// Parameters of scene/list_touched.comp, which lists the surfels that have a gradient.
struct ListTouchedParams {
    RELIDAR_OF(Uints, TouchedSurfels) touched;  // input [n_rows] 0 or 1
    RELIDAR_OF(Uints, TouchedRows) rows;        // output, at most [n_rows]
    RELIDAR_OF(Uints, TouchedCount) count;      // in place [1], 0 before
    uint n_rows;
};

RELIDAR_SHARED_END
#endif
