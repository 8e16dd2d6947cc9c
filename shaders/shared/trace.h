// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that trace rays.
#ifndef RELIDAR_INCLUDED_SHARED_TRACE_H
#define RELIDAR_INCLUDED_SHARED_TRACE_H
#include "relidar/shared/bvh.h"
#include "relidar/shared/rays.h"
#include "relidar/shared/surfels.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_MAX_PASSES 4096u

/// What every tracing kernel needs. Ray k of the batch is entry first_ray + k * ray_stride of `rays`.
struct TraceScene {
    TlasHandle tlas;        // acceleration structure (ray query)
    Floats proxy_reach;     // input [1] m: how far behind a hit its icosahedron may end (ray query, 3D Gaussians), else address 0
    BvhPointers bvh;        // the tree (software traversal)
    Rays rays;              // input
    Records records;        // input
    Instances instances;    // input
    Floats sh;              // input [n,3,16], read where SH are evaluated a hit
    Uints pass_cap_count;   // accumulated [1]: rays that reached the cap of passes
    Uints visits;           // accumulated [2]: nodes opened, surfels tested, where the kernel counts them (software traversal)
    Targets targets;        // input, as `rays`: what they measured, where the kernel is built for likelihoods; or address 0: nothing
    float near_m;
    float alpha_min;
    float alpha_max;
    float transmittance_min;
    float likelihood_scale_m;       // of the kernel about a measured range
    uint n_instances;
    uint sh_degree;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;           // of the image that the batch is, traced in tiles; 0: rays as they come
};

struct ForwardParams {
    TraceScene scene;
    RenderedRays rendered;   // output [n_rays]
    KeptHits kept;           // output [n_rays,n_kept] the first hits of each ray
    Uints n_overfull;        // accumulated [1] rays with more hits than are kept; not touched where n_kept is 0
    RenderedGeometries geometry;   // output [n_rays], where the kernel is built for it
    uint n_kept;
    float surface_gap_m;     // between the hits of two surfaces, where the kernel is built for modes
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
