// SPDX-License-Identifier: Apache-2.0
// Backend: ray query on a two-level acceleration structure. All geometry is non-opaque, so each candidate is offered; once the
// buffer is closed the ray is shortened to its last hit, or the search would visit everything behind it.
// A surfel's triangles are crossed at the hit itself, and a box is entered before and left behind it. An icosahedron is a surface that
// encloses the hit: it is crossed before and behind. The far crossing lies behind the hit, so behind the start, wherever the near one is,
// and at most `reach` behind it. So the ray is shortened to `reach` behind the last hit, and what it crosses there is not lost, though it
// may begin before the start or hold the sensor. A hit that is offered at both crossings is known the second time.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_RAY_QUERY_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_RAY_QUERY_GLSL
RELIDAR_CONSTANT(uint, BOXES, 0u);

void find_hits(TraceScene scene, Ray ray, Key after) {
    float start = search_start(after);
    rayQueryEXT query;
    rayQueryInitializeEXT(query, accelerationStructureEXT(uvec2(scene.tlas)), gl_RayFlagsNoOpaqueEXT, 0xffu,
                          ray.origin + start * ray.direction, 0.0, ray.direction, 1e30);
    float reach = BOXES == 0u && proxy_triangles() == kProxy_icosahedron ? scene.proxy_reach.at[0] : 0.0;
    float end = 1e30;   // where the query has been told to stop
    while (rayQueryProceedEXT(query)) {
        uint instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false));
        uint primitive = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, false));
        offer(scene, ray, after, instance, BOXES != 0u ? primitive : primitive / proxy_triangles());
        if (!hits_closed) continue;
        float bound = max(last_hit_t() - start, 0.0);
        bound += 1e-4 + 1e-5 * last_hit_t();
        if (BOXES != 0u) {
            if (bound < end) {
                rayQueryGenerateIntersectionEXT(query, bound);
                end = bound;
            }
        } else if (rayQueryGetIntersectionTEXT(query, false) > bound + reach) {
            rayQueryConfirmIntersectionEXT(query);
        }
    }
}
#endif
