// SPDX-License-Identifier: Apache-2.0
// What the kernels that trace rays share: rays, targets, rendered values and their gradients (forward, loss, backward).
#ifndef RELIDAR_INCLUDED_SHARED_TRACE_H
#define RELIDAR_INCLUDED_SHARED_TRACE_H
#include "bvh.h"
#include "scene.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_MAX_PASSES 4096u
#define RELIDAR_NO_INSTANCE 0xffffffffu

struct RayEntry {
    vec3 origin;      // world, m
    vec3 direction;   // world, unit
};
RELIDAR_POINTER(Rays, RayEntry);

/// What a ray measured.
struct RayTarget {
    float range_m;     // 0 = dropped
    float intensity;   // 0..1
    float weight;      // 0 = unknown (masked), takes no part in any loss
};
RELIDAR_POINTER(Targets, RayTarget);

/// What a ray renders (M5).
struct RenderedRay {
    float depth;           // D = sum w t, m
    float weight;          // W = sum w
    float intensity;
    float hit_logit;
    float drop_logit;      // includes the background's T * 1
    float transmittance;   // T after the last blended surfel
    float median_depth;    // t where T crosses 0.5, 0 where it never does
    uint n_hits;
    uint instance;         // of the surfel at which T crosses 0.5, else of the nearest blended one, else RELIDAR_NO_INSTANCE
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

/// What a ray renders for the geometric losses, where they want it (M10, M11); n is a surfel's unit normal in the world on the side that
/// faces the sensor, t_0 the distance of the ray's first hit.
struct RenderedGeometry {
    vec3 normal;        // B = sum w n
    float distortion;   // sum over pairs of hits, each once, of w_i w_j |t_i - t_j|, m
    float moment;       // sum w (t - t_0), m
};
RELIDAR_POINTER(RenderedGeometries, RenderedGeometry);

/// What they give back: gradients of the above, and of the ray's point origin + range * direction where they take it to move with the ray.
struct GeometryGradient {
    vec3 normal;
    float distortion;
    vec3 point;
    float range;        // m
};
RELIDAR_POINTER(GeometryGradients, GeometryGradient);

RELIDAR_POINTER(TlasAddress, uint);   // nothing is read through it

/// What every tracing kernel needs. Ray k of the batch is entry first_ray + k * ray_stride of `rays`.
struct TraceScene {
    TlasAddress tlas;       // acceleration structure (ray query)
    Floats proxy_reach;     // input [1] m: how far behind a hit its icosahedron may end (ray query, 3D Gaussians), else address 0
    BvhPointers bvh;        // the tree (software traversal)
    Rays rays;              // input
    Records records;        // input
    Instances instances;    // input
    Floats sh;              // input [n,3,16], read where SH are evaluated a hit
    Uints pass_cap_count;   // accumulated [1]: rays that reached the cap of passes
    Uints visits;           // accumulated [2]: nodes opened, surfels tested, where the kernel counts them (software traversal)
    float near_m;
    float alpha_min;
    float alpha_max;
    float transmittance_min;
    uint n_instances;
    uint sh_degree;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;           // of the image that the batch is, traced in tiles; 0: rays as they come
};

/// A blended hit, so that it need not be searched again.
struct KeptHit {
    uint instance;
    uint surfel;
};
RELIDAR_POINTER(KeptHits, KeptHit);

struct ForwardParams {
    TraceScene scene;
    RenderedRays rendered;   // output [n_rays]
    KeptHits kept;           // output [n_rays,n_kept] the first hits of each ray
    RenderedGeometries geometry;   // output [n_rays], where the kernel is built for it
    uint n_kept;
};

/// Ordered hits of each ray, for tests of the traversal contract.
struct CollectHitsParams {
    TraceScene scene;
    Uints counts;        // output [n_rays] hits found, also beyond max_hits
    Floats t;            // output [n_rays,max_hits] m
    Uints instance;      // output [n_rays,max_hits]
    Uints surfel;        // output [n_rays,max_hits]
    uint max_hits;
};

RELIDAR_SHARED_END
#endif
