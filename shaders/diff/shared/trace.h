// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that trace rays.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_TRACE_H
#define RELIDAR_INCLUDED_DIFF_SHARED_TRACE_H
#include "relidar/diff/bvh.h"
#include "relidar/diff/rays.h"
#include "relidar/scene/surfels.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_MAX_PASSES 4096u

/// What every tracing kernel needs. Ray k of the batch is entry first_ray + k *
/// ray_stride of `rays`.
struct TraceScene {
    TlasHandle tlas;  // acceleration structure (ray query)
    // input [1] m: how far behind a hit its icosahedron may end (ray query, 3D
    // Gaussians), else address 0
    RELIDAR_OF(Floats, ProxyReach) proxy_reach;
    MovingInstances moving;  // input [n_moving] (ray query)
    // input [n_models] m, about the models' origins (ray query)
    RELIDAR_OF(Floats, ModelRadii) model_radii;
    BvhPointers bvh;                                 // the tree (software traversal)
    Rays rays;                                       // input
    Records records;                                 // input
    Instances instances;                             // input
    RELIDAR_OF(Floats, Harmonics) sh;                // input [n,3,16], read where SH are evaluated a hit
    RELIDAR_OF(Uints, PassCapCount) pass_cap_count;  // accumulated [1]: rays that reached the cap of passes
    // accumulated [2]: nodes opened, surfels tested, where the kernel counts them
    // (software traversal)
    RELIDAR_OF(Uints, VisitCounters) visits;
    // input, as `rays`: what they measured, where the kernel is built for likelihoods; or
    // address 0: nothing
    Targets targets;
    float near_m;
    float alpha_min;
    float alpha_max;
    float transmittance_min;
    float likelihood_scale_m;  // of the kernel about a measured range
    uint n_instances;
    uint n_moving;  // 0 in the software traversal
    uint sh_degree;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;  // of the image that the batch is, traced in tiles; 0: rays as they come
};

#define RELIDAR_MOST_ROOM 512  // of a list
// hits of a list that a lane holds to sort it: so its room is no more than 16 a lane
#define RELIDAR_MOST_HELD 16
#define RELIDAR_SORTED_TOGETHER 4u       // lists that a workgroup sorts
#define RELIDAR_LIST_CLOSED 0x80000000u  // beside a length: the ray ends within the list
#define RELIDAR_LIST_UNFIT 0xffffffffu   // in its place: forward/trace renders the ray

/// A list of hits for each thread that traces.
struct HitLists {
    Hits hits;                               // [ceil(n/2),room,2]
    RELIDAR_OF(Uints, ListLengths) lengths;  // [n]
    uint n;
    uint room;  // hits of a list
};

/// What a ray renders: of its list (forward/blend), or traced (forward/trace).
struct ForwardParams {
    TraceScene scene;
    HitLists lists;         // forward/trace: where there are any, only rays whose list is unfit are traced
    RenderedRays rendered;  // output [n_rays]
    Hits kept;              // output [ceil(n/2),n_kept,2] of n threads, their rays' first hits
    // accumulated [1] rays with more hits than are kept; not touched where n_kept is 0
    RELIDAR_OF(Uints, OverfullCount) n_overfull;
    RenderedSurfaces surfaces;  // output [n_rays], where the kernel is built for normals or modes
    uint n_kept;
    uint kept_in_lists;   // 1: they are lists.hits
    float surface_gap_m;  // between the hits of two surfaces, where the kernel is built for modes
};

struct AppendParams {
    TraceScene scene;
    HitLists lists;  // output: hits as they were found
    // accumulated [1] rays with more hits than a list has room for
    RELIDAR_OF(Uints, OverflowCount) n_overflows;
};

struct SortHitsParams {
    HitLists lists;  // in and output: hits in the order of their keys
};

/// Ordered hits of each ray, for tests of the traversal contract.
struct CollectHitsParams {
    TraceScene scene;
    RELIDAR_OF(Uints, HitCounts) counts;       // output [n_rays] hits found, also beyond max_hits
    RELIDAR_OF(Floats, HitDistances) t;        // output [n_rays,max_hits] m
    RELIDAR_OF(Uints, HitInstances) instance;  // output [n_rays,max_hits]
    RELIDAR_OF(Uints, HitSurfels) surfel;      // output [n_rays,max_hits]
    uint max_hits;
};

RELIDAR_SHARED_END
#endif
