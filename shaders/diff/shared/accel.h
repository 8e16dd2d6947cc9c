// SPDX-License-Identifier: Apache-2.0
// Proxy geometry (M3), k = sqrt(2 ln(sigma / alpha_min)). Of a surfel: a rectangle of
// half sizes k s_u, k s_v, as two triangles. Of a 3D Gaussian: the icosahedron around the
// ellipsoid of half axes k s_u, k s_v, k s_w. Or the axis-aligned box of either.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_ACCEL_H
#define RELIDAR_INCLUDED_DIFF_SHARED_ACCEL_H
#include "../../scene/shared/scene.h"

RELIDAR_SHARED_BEGIN

struct ProxyParams {
    Records records;  // input [n], of all surfels
    // output m: four corners [n,4,3] of a surfel, twelve [n,12,3] of a 3D Gaussian (proxy
    // = triangles), or
    RELIDAR_OF(Floats, ProxyVertices) vertices;
    RELIDAR_OF(Floats, SurfelBoxes) boxes;  // output [n,6] m: min, max (proxy = boxes)
    // maximum [1], bits of a float, m: no point of a 3D Gaussian's icosahedron is farther
    // from a hit in it (proxy = triangles)
    Uints reach;
    float alpha_min;     // the proxy ends where sigma G = alpha_min
    float margin_m;      // grown by this, so that rounding in a traversal loses no hit
    float margin_scale;  // and by this factor
    uint first_surfel;   // of those whose proxies are made
    uint n_surfels;
};

#define RELIDAR_RADIUS_STRETCH 64u  // surfels of a thread of accel/model_radii

/// How far from its origin each model reaches (accel/model_radii.comp).
struct ModelRadiiParams {
    Records records;                      // input [n], of all surfels
    Models models;                        // input [n_models]
    RELIDAR_OF(Uints, ModelRadii) radii;  // maximum [n_models] m, bits of floats
    float alpha_min;                      // a surfel ends where sigma G = alpha_min
    float margin_m;                       // added to each radius
    float margin_scale;                   // and its factor
    uint n_models;
    uint first_surfel;  // of the range
    uint n_surfels;     // of the range
};

RELIDAR_SHARED_END
#endif
