// SPDX-License-Identifier: Apache-2.0
// Data of rays on a device, one entry per ray: the ray, its measurement, its rendered
// values and the gradients from the losses. C++ and kernels share these structs.
#ifndef RELIDAR_INCLUDED_DIFF_RAYS_H
#define RELIDAR_INCLUDED_DIFF_RAYS_H
#include "relidar/base/lang.h"
#include "relidar/diff/blended_values.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_NO_INSTANCE 0xffffffffu
// Firing time of a ray that meets every instance at the pose in the instance table.
#define RELIDAR_NO_TIME 3.0e38f

struct DeviceRay {
    vec3 origin;     // Origin, metres, world frame.
    vec3 direction;  // Unit direction, world frame.
    float time_s;    // Firing time in seconds after the reference time of the sweep, or RELIDAR_NO_TIME.
};
RELIDAR_POINTER(Rays, DeviceRay);

/// Measurement of a ray.
struct DeviceTarget {
    float range_m;    // Measured range, metres; 0 = dropped.
    float intensity;  // Measured intensity, 0..1.
    float weight;     // Weight in the losses; 0 = unknown (masked), the ray has no effect on any loss.
};
RELIDAR_POINTER(Targets, DeviceTarget);

#define RELIDAR_FIELD(name, built, value, input, slope, meaning) float name;

/// Output of the forward pass for a ray (M5): the blended values and data about the hits.
struct RenderedRay {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
    float transmittance;  // Transmittance T after the last blended surfel.
    float median_depth;   // Distance t at which T crosses 0.5; 0 if T stays above 0.5.
    uint n_hits;
    // Instance of the surfel at which T crosses 0.5; otherwise of the nearest blended
    // surfel; RELIDAR_NO_INSTANCE without hits.
    uint instance;
};
RELIDAR_POINTER(RenderedRays, RenderedRay);

/// Gradient of the loss with respect to the blended values of a ray.
struct RayGradient {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
};
RELIDAR_POINTER(RayGradients, RayGradient);
#undef RELIDAR_FIELD

/// Surface that a ray hits, rendered without gradients.
struct RenderedSurface {
    vec3 normal;  // Sum of w n, where n is a surfel's unit normal that faces the sensor, world frame.
    float mode;   // Mean of t over the heaviest surface of the ray (M13), metres; 0 without hits.
};
RELIDAR_POINTER(RenderedSurfaces, RenderedSurface);

/// Hit of a ray: in the buffer of the ray, in its list, or kept for the backward pass.
struct Hit {
    float t;      // Distance along the ray, metres.
    float alpha;  // Opacity times Gaussian weight, sigma G, not clamped.
    uint instance;
    uint surfel;
};
RELIDAR_POINTER(Hits, Hit);
// Number of rays whose hit lists, or kept hits, are interleaved in memory.
#define RELIDAR_SIDE_BY_SIDE 2u

RELIDAR_SHARED_END
#endif
