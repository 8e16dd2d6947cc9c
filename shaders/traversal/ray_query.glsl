// SPDX-License-Identifier: Apache-2.0
// Backend: ray query on a two-level acceleration structure. All geometry is non-opaque, so each candidate is offered; once the
// buffer is closed the ray is shortened to its last hit, or the search would visit everything behind it.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_RAY_QUERY_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_RAY_QUERY_GLSL
layout(constant_id = 2) const uint BOXES = 0u;   // 0: two triangles a surfel, 1: one axis-aligned box

void next_hits(TraceScene scene, Ray ray, Key after, float budget) {
    reset_hits(budget);
    float start = search_start(after);
    rayQueryEXT query;
    rayQueryInitializeEXT(query, accelerationStructureEXT(scene.tlas), gl_RayFlagsNoOpaqueEXT, 0xffu,
                          ray.origin + start * ray.direction, 0.0, ray.direction, 1e30);
    float end = 1e30;   // where the query has been told to stop
    while (rayQueryProceedEXT(query)) {
        uint instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false));
        uint primitive = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, false));
        offer(scene, ray, after, instance, BOXES != 0u ? primitive : primitive / 2u);
        if (!hits_closed) continue;
        float bound = hit_t[n_hits - 1u] - start;
        bound += 1e-4 + 1e-5 * hit_t[n_hits - 1u];
        if (BOXES != 0u) {
            if (bound < end) {
                rayQueryGenerateIntersectionEXT(query, bound);
                end = bound;
            }
        } else if (rayQueryGetIntersectionTEXT(query, false) > bound) {
            rayQueryConfirmIntersectionEXT(query);
        }
    }
}
#endif
