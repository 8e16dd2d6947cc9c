// SPDX-License-Identifier: Apache-2.0
// Parameters of the kernels that find and blend the hits of rays.
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
    // Input [1], m. A ray query finds a 3D Gaussian where the ray enters or leaves an
    // icosahedron around it. The ray leaves at most this distance behind the hit, so
    // queries search this far behind the last hit. Address 0 if no icosahedra are used.
    RELIDAR_OF(Floats, ProxyReach) proxy_reach;
    MovingInstances moving;  // input [n_moving] (ray query)
    // Input [n_models] in m: radius of each model's bounding sphere, whose centre is the
    // origin of the model. Used by ray queries.
    RELIDAR_OF(Floats, ModelRadii) model_radii;
    BvhPointers bvh;                   // the tree (software traversal)
    Rays rays;                         // input
    Records records;                   // input
    Instances instances;               // input
    RELIDAR_OF(Floats, Harmonics) sh;  // input [n,3,16], read if SH are evaluated per hit
    // Counter [1]: number of rays whose search for hits ended too early. Such a ray
    // needed more than RELIDAR_MAX_PASSES searches, or the traversal stack overflowed.
    RELIDAR_OF(Uints, PassCapCount) pass_cap_count;
    // Accumulated [2]: number of visited tree nodes and number of tested surfels. Written
    // only by kernel variants that count visits.
    RELIDAR_OF(Uints, VisitCounters) visits;
    // Input: measurements of the rays, or address 0. Used only by kernel variants that
    // compute likelihoods.
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
    // Number of image columns if the rays form an image, which is then traced in tiles.
    // 0 = rays are traced in their order.
    uint columns;
};

#define RELIDAR_MOST_ROOM 512  // maximum capacity of a list
// Maximum number of hits per thread while a subgroup sorts a hit list. A list must not
// exceed this number times the subgroup size.
#define RELIDAR_MOST_HELD 16
#define RELIDAR_SORTED_TOGETHER 4u  // lists that one workgroup sorts
// Bit in the length of a ray's hit list. It is set if the ray ends at one of these hits,
// because the transmittance falls below transmittance_min.
#define RELIDAR_LIST_CLOSED 0x80000000u
// Marks the hit list of a ray as incomplete. Kernels store this value instead of the
// list's length. Kernel forward/trace then renders the ray without the list.
#define RELIDAR_LIST_UNFIT 0xffffffffu

struct HitLists {
    Hits hits;                               // [ceil(n/2),room,2]
    RELIDAR_OF(Uints, ListLengths) lengths;  // [n]
    uint n;
    uint room;  // capacity of a list in hits
};

/// Parameters of the two forward kernels. forward/blend blends hits from lists.
/// forward/trace searches and blends hits without lists.
struct ForwardParams {
    TraceScene scene;
    // Hit list of each ray. If lists are used, forward/blend renders all rays with a
    // complete list. Then forward/trace renders the remaining rays.
    HitLists lists;
    RenderedRays rendered;  // output [n_rays]
    // Output for the backward pass: the nearest n_kept hits of each ray. Each of n
    // threads has one ray. Two threads interleave their hits: hit k of thread i is
    // element [i/2,k,i%2] of the array [ceil(n/2),n_kept,2].
    Hits kept;
    // Counter [1]: number of rays with more than n_kept hits. Stays unchanged if n_kept
    // is 0.
    RELIDAR_OF(Uints, OverfullCount) n_overfull;
    // Output [n_rays]: normal and distance of the surface that each ray hits. Written
    // only by kernel variants that compute one of them.
    RenderedSurfaces surfaces;
    uint n_kept;
    uint kept_in_lists;  // 1: the stored hits share the memory of lists.hits.
    // Hits of a ray that are closer together than this distance in m belong to the same
    // surface. Used only to find the surface with the largest blending weight.
    float surface_gap_m;
};

struct AppendParams {
    TraceScene scene;
    HitLists lists;  // output: unordered hits
    // Counter [1]: number of rays that have more hits than a hit list can hold.
    RELIDAR_OF(Uints, OverflowCount) n_overflows;
};

struct SortHitsParams {
    HitLists lists;  // in and output: hits sorted by key
};

struct CollectHitsParams {
    TraceScene scene;
    RELIDAR_OF(Uints, HitCounts) counts;  // output [n_rays] number of hits, may exceed max_hits
    Hits hits;                            // output [n_rays,max_hits]
    uint max_hits;
};

RELIDAR_SHARED_END
#endif
