// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that compute proxy geometry for ray queries (docs/method.md
// M3), with k = sqrt(2 ln(sigma / alpha_min)). The proxy of a surfel is a rectangle with
// half sizes k s_u, k s_v, stored as two triangles. The proxy of a 3D Gaussian is an
// icosahedron around the ellipsoid with half axes k s_u, k s_v, k s_w. Alternatively, the
// proxy is the axis-aligned box of the surfel or 3D Gaussian.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_ACCEL_H
#define RELIDAR_INCLUDED_DIFF_SHARED_ACCEL_H
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

struct ProxyParams {
    Records records;  // input [n], all surfels
    // Output in m: corners of the shapes around surfels, [n,4,3] for surfels or [n,12,3]
    // for 3D Gaussians. Written only if the shapes consist of triangles.
    RELIDAR_OF(Floats, ProxyVertices) vertices;
    // Output [n,6] in m: lower and upper corners of the boxes around surfels. Written
    // only if the shapes are boxes.
    RELIDAR_OF(Floats, SurfelBoxes) boxes;
    // Output: one distance in m, as the bits of a float. It is the largest possible
    // distance between a hit on a 3D Gaussian and a corner of the icosahedron around this
    // Gaussian. Written only for icosahedra.
    Uints reach;
    float alpha_min;  // Opacity threshold. The proxy encloses all points with sigma G >= alpha_min.
    // Margin in m that is added to the shape around each surfel, so that rounding errors
    // of the traversal cannot lose a hit.
    float margin_m;
    // Factor on the size of the shape around each surfel. margin_m is added afterwards.
    float margin_scale;
    uint first_surfel;  // first surfel of the range
    uint n_surfels;
};

#define RELIDAR_RADIUS_STRETCH 64u  // surfels per thread of accel/model_radii

struct ModelRadiiParams {
    Records records;  // input [n], all surfels
    Models models;    // input [n_models]
    // Output [n_models] in m, stored as float bits: distance of the farthest possible hit
    // from the model's origin.
    RELIDAR_OF(Uints, ModelRadii) radii;
    float alpha_min;     // Opacity threshold. A ray hits a surfel only where sigma G >= alpha_min.
    float margin_m;      // added to each radius
    float margin_scale;  // factor on each radius
    uint n_models;
    uint first_surfel;  // first surfel of the range
    uint n_surfels;     // number of surfels of the range
};

RELIDAR_SHARED_END
#endif
