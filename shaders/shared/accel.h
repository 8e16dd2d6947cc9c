// SPDX-License-Identifier: Apache-2.0
// Proxy geometry of surfels (M3): a rectangle of half sizes k s_u, k s_v with k = sqrt(2 ln(255 sigma)), as two triangles or
// as its axis-aligned box.
#ifndef RELIDAR_INCLUDED_SHARED_ACCEL_H
#define RELIDAR_INCLUDED_SHARED_ACCEL_H
#include "scene.h"

RELIDAR_SHARED_BEGIN

struct ProxyParams {
    Records records;     // input [n_surfels of the scene]
    Floats vertices;     // output [n,4,3] m: four corners (proxy = triangles), or
    Floats boxes;        // output [n,6] m: min, max (proxy = boxes)
    float alpha_min;     // the proxy ends where sigma G = alpha_min
    float margin_m;      // grown by this, so that rounding in a traversal loses no hit
    float margin_scale;  // and by this factor
    uint n_surfels;
};

RELIDAR_SHARED_END
#endif
