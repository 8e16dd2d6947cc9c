// SPDX-License-Identifier: Apache-2.0
// Data of rays on a device, one entry per ray: the ray, its measurement, its rendered
// values and the gradients from the losses. C++ and kernels share these structs.
#ifndef RELIDAR_INCLUDED_DIFF_RAYS_H
#define RELIDAR_INCLUDED_DIFF_RAYS_H
#include "relidar/base/lang.h"

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

/// Rendered values of a ray (M5).
struct RenderedRay {
    float depth;   // Depth D = sum w t, metres.
    float weight;  // Accumulated weight W = sum w.
    float intensity;
    float hit_logit;
    float drop_logit;     // Drop logit, including the background's T * 1.
    float transmittance;  // Transmittance T after the last blended surfel.
    float median_depth;   // Median range: t at which T crosses 0.5, metres; 0 if T stays above 0.5.
    uint n_hits;
    // Instance of the surfel at which T crosses 0.5; otherwise of the nearest blended
    // surfel; RELIDAR_NO_INSTANCE without hits.
    uint instance;
};
RELIDAR_POINTER(RenderedRays, RenderedRay);

/// Gradient of the loss with respect to the rendered values of a ray.
struct RayGradient {
    float depth;
    float weight;
    float intensity;
    float hit_logit;
    float drop_logit;
};
RELIDAR_POINTER(RayGradients, RayGradient);

/// Additional rendered values of a ray for the geometric losses (M10-M12) and for range
/// images (M13). n is the unit normal of a surfel in the world frame, facing the sensor.
/// t_0 is the range of the ray's first hit.
struct RenderedGeometry {
    vec3 normal;  // Blended normal B = sum w n.
    // Distortion: sum over pairs of hits, each pair once, of w_i w_j |t_i - t_j|, metres.
    float distortion;
    float moment;  // First moment of the hits: sum w (t - t_0), metres.
    // Likelihood S = sum w k(t), where the kernel k is centred at the measured range
    // (M12); 0 without a measured range.
    float likelihood;
    float mode;  // Mean of t over the heaviest surface of the ray (M13), metres; 0 without hits.
};
RELIDAR_POINTER(RenderedGeometries, RenderedGeometry);

// Gradients of the loss with respect to RenderedGeometry, and to the ray's point origin +
// range * direction, which moves with the ray.
struct GeometryGradient {
    vec3 normal;
    float distortion;
    vec3 point;
    float range;  // Gradient with respect to the range, 1/m.
    float likelihood;
};
RELIDAR_POINTER(GeometryGradients, GeometryGradient);

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
