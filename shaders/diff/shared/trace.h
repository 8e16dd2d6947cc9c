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
    // Input [1] in m: largest distance from a hit to the far side of its icosahedron.
    // Used for ray queries with 3D Gaussians, otherwise address 0.
    RELIDAR_OF(Floats, ProxyReach) proxy_reach;
    MovingInstances moving;  // input [n_moving] (ray query)
    // Input [n_models] in m: radius of each model around its origin. Used for ray
    // queries.
    RELIDAR_OF(Floats, ModelRadii) model_radii;
    BvhPointers bvh;                   // the tree (software traversal)
    Rays rays;                         // input
    Records records;                   // input
    Instances instances;               // input
    RELIDAR_OF(Floats, Harmonics) sh;  // input [n,3,16], read if SH are evaluated per hit
    // Accumulated [1]: number of rays that reached the maximum number of passes.
    RELIDAR_OF(Uints, PassCapCount) pass_cap_count;
    // Accumulated [2]: number of visited nodes and of tested surfels. Only kernels of the
    // software traversal that count visits write it.
    RELIDAR_OF(Uints, VisitCounters) visits;
    // Input: measurements of the rays. Address 0 means no measurements. Used only by
    // kernels that are built with likelihoods.
    Targets targets;
    float near_m;
    float alpha_min;
    float alpha_max;
    float transmittance_min;
    float likelihood_scale_m;  // Scale of the likelihood around a measured range, m.
    uint n_instances;
    uint n_moving;  // 0 in the software traversal
    uint sh_degree;
    uint n_rays;
    uint first_ray;
    uint ray_stride;
    // Number of columns of the image that the batch forms. Its rays are traced in tiles.
    // 0 means that rays are traced in their order.
    uint columns;
};

#define RELIDAR_MOST_ROOM 512  // maximum capacity of a list
// Maximum number of hits per lane while a subgroup sorts a list. So a list can hold at
// most 16 hits per lane.
#define RELIDAR_MOST_HELD 16
#define RELIDAR_SORTED_TOGETHER 4u  // lists that a workgroup sorts
// Flag in the length of a hit list: the transmittance falls below the limit within the
// list, so the ray ends there.
#define RELIDAR_LIST_CLOSED 0x80000000u
// Value of a list's length if the list cannot be used. Kernel forward/trace then renders
// the ray.
#define RELIDAR_LIST_UNFIT 0xffffffffu

/// Hit lists, one for each tracing thread.
struct HitLists {
    Hits hits;                               // [ceil(n/2),room,2]
    RELIDAR_OF(Uints, ListLengths) lengths;  // [n]
    uint n;
    uint room;  // capacity of a list in hits
};

/// Parameters of the forward kernels. Kernel forward/blend blends the hits of lists.
/// Kernel forward/trace finds and blends hits.
struct ForwardParams {
    TraceScene scene;
    // Hit lists of the rays. If they exist, forward/trace traces only rays whose list
    // could not be used.
    HitLists lists;
    RenderedRays rendered;  // output [n_rays]
    // Output [ceil(n/2),n_kept,2]: first hits of the rays of n threads, for the backward
    // pass.
    Hits kept;
    // Accumulated [1]: number of rays with more hits than are stored. Not used if n_kept
    // is 0.
    RELIDAR_OF(Uints, OverfullCount) n_overfull;
    // Output [n_rays]: surface of each ray. Written only by kernels that are built with
    // normals or modes.
    RenderedSurfaces surfaces;
    uint n_kept;
    uint kept_in_lists;  // 1: the hits for the backward pass are stored in the same memory as lists.hits.
    // Minimum distance between two surfaces of a ray. Used only by kernels that are built
    // with modes.
    float surface_gap_m;
};

struct AppendParams {
    TraceScene scene;
    HitLists lists;  // output: unordered hits
    // Accumulated [1]: number of rays with more hits than a list can hold.
    RELIDAR_OF(Uints, OverflowCount) n_overflows;
};

struct SortHitsParams {
    HitLists lists;  // in and output: hits sorted by key
};

/// Parameters of the kernel that writes all hits of each ray from near to far, for tests.
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
