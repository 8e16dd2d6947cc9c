// SPDX-License-Identifier: Apache-2.0
// Structs for rays on a device: the ray, its measurement, its rendered values and its
// gradients. Device arrays of these structs have one entry per ray. C++ and kernels share
// these structs.
#ifndef RELIDAR_INCLUDED_DIFF_RAYS_H
#define RELIDAR_INCLUDED_DIFF_RAYS_H
#include "relidar/base/lang.h"
#include "relidar/diff/blended_values.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_NO_INSTANCE 0xffffffffu
// Firing time of a ray whose firing time is unknown. For this ray, each instance has the
// pose that the instance table stores, without motion.
#define RELIDAR_NO_TIME 3.0e38f

struct DeviceRay {
    vec3 origin;     // Origin, metres, world frame.
    vec3 direction;  // Unit direction, world frame.
    float time_s;    // Firing time in seconds after the reference time of the sweep, or RELIDAR_NO_TIME.
};
RELIDAR_DECLARE_POINTER(Rays, DeviceRay);

/// Measured values of a ray. Losses compare the rendered values with these values.
struct DeviceTarget {
    float range_m;    // Measured range, metres. 0 = no return.
    float intensity;  // Measured intensity, 0..1.
    // Weight of the ray in the losses. 0 = the measurement is unknown (masked), so the
    // ray has no effect.
    float weight;
};
RELIDAR_DECLARE_POINTER(Targets, DeviceTarget);

#define RELIDAR_FIELD(name, built, value, input, slope, meaning) float name;

/// Result of the forward pass for one ray: the blended values (docs/method.md M5) and
/// information about the hits.
struct RenderedRay {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
    float transmittance;  // Transmittance T after the last blended surfel.
    float median_depth;   // Distance t at which T crosses 0.5, metres. 0 if T stays above 0.5.
    uint n_hits;
    // Instance of the surfel at which the transmittance falls below 0.5. If the
    // transmittance stays above 0.5, the instance of the nearest blended surfel. Without
    // hits, RELIDAR_NO_INSTANCE.
    uint instance;
};
RELIDAR_DECLARE_POINTER(RenderedRays, RenderedRay);

/// Gradient of the loss with respect to the blended values of a ray.
struct RayGradient {
    RELIDAR_BLENDED_VALUES(RELIDAR_FIELD)
};
RELIDAR_DECLARE_POINTER(RayGradients, RayGradient);
#undef RELIDAR_FIELD

/// Normal and distance of the surface that a ray hits. No gradients of these values are
/// computed.
struct RenderedSurface {
    // Sum of w n over the hits, world frame. w is the weight of a hit, and n is the
    // surfel's unit normal that faces the sensor.
    vec3 normal;
    // Mean distance of the surface with the largest total weight along the ray
    // (docs/method.md M13), metres. 0 if the ray has no hits.
    float mode;
};
RELIDAR_DECLARE_POINTER(RenderedSurfaces, RenderedSurface);

struct Hit {
    float t;      // Distance along the ray, metres.
    float alpha;  // Opacity times the Gaussian's value at the hit (sigma G), not clamped.
    uint instance;
    uint surfel;
};
RELIDAR_DECLARE_POINTER(Hits, Hit);
// Number of rays whose hits are interleaved in memory.
#define RELIDAR_SIDE_BY_SIDE 2u

RELIDAR_SHARED_END
#endif
