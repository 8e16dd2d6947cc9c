// SPDX-License-Identifier: Apache-2.0
// Point of a simulated scan in device memory. C++ and kernels share this struct.
#ifndef RELIDAR_INCLUDED_SIMULATE_RETURNED_POINT_H
#define RELIDAR_INCLUDED_SIMULATE_RETURNED_POINT_H
#include "relidar/diff/rays.h"

RELIDAR_SHARED_BEGIN

struct ReturnedPoint {
    vec3 position;        // m
    float intensity;      // 0..1
    float time_offset_s;  // Firing time of the ray, relative to the reference time of the sweep, s.
    uint ring;            // beam number
    uint instance;        // Instance that contains the point, or RELIDAR_NO_INSTANCE.
};
RELIDAR_DECLARE_POINTER(ReturnedPoints, ReturnedPoint);

RELIDAR_SHARED_END
#endif
