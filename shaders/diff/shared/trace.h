// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that trace rays.
#ifndef RELIDAR_INCLUDED_DIFF_SHARED_TRACE_H
#define RELIDAR_INCLUDED_DIFF_SHARED_TRACE_H
#include "relidar/diff/bvh.h"
#include "relidar/diff/rays.h"
#include "relidar/scene/surfels.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_MAX_PASSES 4096u

/// Parameters that every tracing kernel needs. Ray k of the batch is entry first_ray + k
/// * ray_stride of `rays`.
struct TraceScene {
    TlasHandle tlas;  // acceleration structure (ray query)
    // Input [1] m: largest distance from a hit to the far side of its icosahedron (ray
    // query, 3D Gaussians), otherwise address 0.
    RELIDAR_OF(Floats, ProxyReach) proxy_reach;
    MovingInstances moving;  // input [n_moving] (ray query)
    // Input [n_models] m, radius around the model's origin (ray query).
    RELIDAR_OF(Floats, ModelRadii) model_radii;
    BvhPointers bvh;                   // the tree (software traversal)
    Rays rays;                         // input
    Records records;                   // input
    Instances instances;               // input
    RELIDAR_OF(Floats, Harmonics) sh;  // input [n,3,16], read if SH are evaluated per hit
    // accumulated [1]: rays that reached the maximum number of passes
    RELIDAR_OF(Uints, PassCapCount) pass_cap_count;
    // Accumulated [2]: visited nodes and tested surfels, if the kernel counts them
    // (software traversal).
    RELIDAR_OF(Uints, VisitCounters) visits;
    // Input: measurements of `rays`, if the kernel is built with likelihoods. Address 0:
    // no measurements.
    Targets targets;
    float near_m;
    float alpha_min;
    float alpha_max;
    float transmittance_min;
    float likelihood_scale_m;  // scale of the kernel around a measured range
    uint n_instances;
    uint n_moving;  // 0 in the software traversal
    uint sh_degree;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    uint columns;  // columns of the image that the batch forms, traced in tiles; 0: the order of the rays
};

#define RELIDAR_MOST_ROOM 512  // maximum capacity of a list
// Maximum number of hits that a lane holds while it sorts a list. The capacity of a list
// is therefore at most 16 per lane.
#define RELIDAR_MOST_HELD 16
#define RELIDAR_SORTED_TOGETHER 4u       // lists that a workgroup sorts
#define RELIDAR_LIST_CLOSED 0x80000000u  // flag of a list's length: the ray ends within the list
#define RELIDAR_LIST_UNFIT 0xffffffffu   // instead of a list's length: forward/trace renders the ray

/// Hit lists, one for each tracing thread.
struct HitLists {
    Hits hits;                               // [ceil(n/2),room,2]
    RELIDAR_OF(Uints, ListLengths) lengths;  // [n]
    uint n;
    uint room;  // capacity of a list in hits
};

/// Parameters of the forward kernels: forward/blend blends hit lists, forward/trace
/// traces rays.
struct ForwardParams {
    TraceScene scene;
    HitLists lists;         // if there are lists, forward/trace traces only rays with an unfit list
    RenderedRays rendered;  // output [n_rays]
    Hits kept;              // output [ceil(n/2),n_kept,2] of n threads, first hits of their rays
    // Accumulated [1] rays with more hits than are kept; not used if n_kept is 0.
    RELIDAR_OF(Uints, OverfullCount) n_overfull;
    RenderedSurfaces surfaces;  // output [n_rays], if the kernel is built with normals or modes
    uint n_kept;
    uint kept_in_lists;   // 1: the kept hits are lists.hits
    float surface_gap_m;  // minimum distance between two surfaces, if the kernel is built with modes
};

struct AppendParams {
    TraceScene scene;
    HitLists lists;  // output: unordered hits
    // Accumulated [1] rays with more hits than a list can hold.
    RELIDAR_OF(Uints, OverflowCount) n_overflows;
};

struct SortHitsParams {
    HitLists lists;  // in and output: hits sorted by key
};

/// Ordered hits of each ray, for tests of the traversal contract.
struct CollectHitsParams {
    TraceScene scene;
    RELIDAR_OF(Uints, HitCounts) counts;       // output [n_rays] number of hits, may exceed max_hits
    RELIDAR_OF(Floats, HitDistances) t;        // output [n_rays,max_hits] m
    RELIDAR_OF(Uints, HitInstances) instance;  // output [n_rays,max_hits]
    RELIDAR_OF(Uints, HitSurfels) surfel;      // output [n_rays,max_hits]
    uint max_hits;
};

RELIDAR_SHARED_END
#endif
