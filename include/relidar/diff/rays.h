// SPDX-License-Identifier: Apache-2.0
// Rays on a device: what is traced, what they measured, what they render and what losses
// give back, one entry a ray. Kernels blend these structs, stages hand them on as arrays.
#ifndef RELIDAR_INCLUDED_DIFF_RAYS_H
#define RELIDAR_INCLUDED_DIFF_RAYS_H
#include "relidar/base/lang.h"
#include "relidar/diff/blended_values.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_NO_INSTANCE 0xffffffffu
#define RELIDAR_NO_TIME 3.0e38f  // of a ray that meets every instance at the pose of its table entry

struct DeviceRay {
    vec3 origin;     // world, m
    vec3 direction;  // world, unit
    float time_s;    // when it is fired, from the sweep's reference time, or RELIDAR_NO_TIME
};
RELIDAR_POINTER(Rays, DeviceRay);

/// What a ray measured.
struct DeviceTarget {
    float range_m;    // 0 = dropped
    float intensity;  // 0..1
    float weight;     // 0 = unknown (masked), takes no part in any loss
};
RELIDAR_POINTER(Targets, DeviceTarget);

#define RELIDAR_FIELD(name, built, value, input, slope, meaning) float name;

/// Output of the forward pass for a ray (M5): the blended values and data about the hits.
struct RenderedRay {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
    float transmittance;  // T after the last blended surfel
    float median_depth;   // t where T crosses 0.5, 0 where it never does
    uint n_hits;
    // of the surfel at which T crosses 0.5, else of the nearest blended one, else
    // RELIDAR_NO_INSTANCE
    uint instance;
};
RELIDAR_POINTER(RenderedRays, RenderedRay);

/// Gradient of the loss with respect to the blended values of a ray.
struct RayGradient {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
};
RELIDAR_POINTER(RayGradients, RayGradient);
#undef RELIDAR_FIELD

/// What a scan needs of the surface that a ray meets; without gradients.
struct RenderedSurface {
    vec3 normal;  // sum w n, n a surfel's unit normal in the world, facing the sensor
    float mode;   // m, mean of t over the heaviest surface of the ray (M13), 0 without hits
};
RELIDAR_POINTER(RenderedSurfaces, RenderedSurface);

/// A hit, in the buffer of a ray, in its list, or kept for the backward pass.
struct Hit {
    float t;      // m
    float alpha;  // sigma G, not clamped
    uint instance;
    uint surfel;
};
RELIDAR_POINTER(Hits, Hit);
#define RELIDAR_SIDE_BY_SIDE 2u  // lists of hits, or hits that are kept of rays

RELIDAR_SHARED_END
#endif
