// SPDX-License-Identifier: Apache-2.0
// Rays on a device: what is traced, what they measured, what they render and what losses
// give back, one entry a ray. Kernels blend these structs, stages hand them on as arrays.
#ifndef RELIDAR_INCLUDED_DIFF_RAYS_H
#define RELIDAR_INCLUDED_DIFF_RAYS_H
#include "relidar/base/lang.h"

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

/// What a ray renders (M5).
struct RenderedRay {
    float depth;   // D = sum w t, m
    float weight;  // W = sum w
    float intensity;
    float hit_logit;
    float drop_logit;     // includes the background's T * 1
    float transmittance;  // T after the last blended surfel
    float median_depth;   // t where T crosses 0.5, 0 where it never does
    uint n_hits;
    // of the surfel at which T crosses 0.5, else of the nearest blended one, else
    // RELIDAR_NO_INSTANCE
    uint instance;
};
RELIDAR_POINTER(RenderedRays, RenderedRay);

/// Gradient of the loss with respect to what a ray renders.
struct RayGradient {
    float depth;
    float weight;
    float intensity;
    float hit_logit;
    float drop_logit;
};
RELIDAR_POINTER(RayGradients, RayGradient);

/// What a ray renders beside its image, where the geometric losses (M10-M12) or a range
/// image (M13) want it; n is a surfel's unit normal in the world on the side that faces
/// the sensor, t_0 the distance of the ray's first hit.
struct RenderedGeometry {
    vec3 normal;       // B = sum w n
    float distortion;  // sum over pairs of hits, each once, of w_i w_j |t_i - t_j|, m
    float moment;      // sum w (t - t_0), m
    // S = sum w k(t), k the kernel about the range that was measured (M12), 0 where none
    // was
    float likelihood;
    float mode;  // m, mean of t over the heaviest surface of the ray (M13), 0 without hits
};
RELIDAR_POINTER(RenderedGeometries, RenderedGeometry);

// What the losses give back: gradients of the above, and of the ray's point origin +
// range * direction where that moves with the ray.
struct GeometryGradient {
    vec3 normal;
    float distortion;
    vec3 point;
    float range;  // m
    float likelihood;
};
RELIDAR_POINTER(GeometryGradients, GeometryGradient);

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
