// SPDX-License-Identifier: Apache-2.0
// Finds hits with Vulkan ray queries on a two-level acceleration structure. All geometry
// is non-opaque, so the shader tests each candidate. When the hit buffer is closed, the
// query stops at the farthest hit of the buffer plus `reach`.
//
// A ray crosses the triangles of a surfel exactly at the hit, and a box or an icosahedron
// before and behind it, at most `reach` behind it. Therefore at least one crossing is
// found, even if the icosahedron contains the sensor. The hit buffer ignores a second
// one.
//
// The driver stores one pose per model. Each model that moves during the sweep needs a
// separate query with a moved ray, and a cull mask limits the first query to models that
// do not move. The sphere around a moving model contains all its hits. The rounding error
// of a moved ray is far below the margin of the proxies.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_QUERY_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_RAY_QUERY_GLSL
RELIDAR_CONSTANT(uint, BOXES, 0u);

/// Returns true if the distance between the ray and the origin of the model is less than
/// `radius_m`, with a margin for rounding errors.
bool is_near_origin(float radius_m) {
    float along = dot(entered_origin, entered_direction);
    vec3 nearest = along < 0.0 ? entered_origin - along * entered_direction : entered_origin;
    float reached = 1.00001 * radius_m + 1e-5 * length(entered_origin);
    return dot(nearest, nearest) <= reached * reached;
}

struct RayQueryParams {
    vec3 origin;  // world, m
    vec3 direction;
    uint mask;
    // Only hits on this instance are used. RELIDAR_NO_INSTANCE means all instances.
    uint instance;
};

/// Writes the parameters of a ray query for one moving instance to `query_params`.
/// @return false if the ray cannot hit the instance
bool prepare_query(TraceScene scene, Ray ray, MovingInstance moving, out RayQueryParams query_params) {
    enter_instance(scene, ray, moving.instance);
    InstanceEntry m = scene.instances.at[moving.instance];
    // The driver transforms rays with the stored pose. This ray is transformed back with
    // that pose, so that the driver gets the moved ray.
    vec3 from_model = entered_origin - vec3(m.row0.w, m.row1.w, m.row2.w);
    query_params.origin = m.row0.xyz * from_model.x + m.row1.xyz * from_model.y + m.row2.xyz * from_model.z;
    query_params.direction = m.row0.xyz * entered_direction.x + m.row1.xyz * entered_direction.y +
                             m.row2.xyz * entered_direction.z;
    query_params.mask = moving.mask;
    query_params.instance = moving.instance;
    return is_near_origin(scene.model_radii.at[moving.model]);
}

void find_hits(TraceScene scene, Ray ray, HitKey previous_key) {
    float start = search_start_t(previous_key);
    float reach = BOXES == 0u && proxy_triangles() == kProxy_icosahedron ? scene.proxy_reach.at[0] : 0.0;
    rayQueryEXT query;
    for (uint k = 0u; k <= scene.n_moving; ++k) {
        RayQueryParams query_params =
            RayQueryParams(ray.origin, ray.direction, RELIDAR_STANDING_MASK, RELIDAR_NO_INSTANCE);
        if (k > 0u && !prepare_query(scene, ray, scene.moving.at[k - 1u], query_params)) continue;
        float end = 1e30;  // distance at which the query stops
        // If hits_closed is true, hits behind last_hit_t() are not needed, so the
        // query may stop there. The margins are for rounding errors and for icosahedra
        // around Gaussians, which the query may find up to `reach` behind the hit.
        if (hits_closed) end = max(last_hit_t() - start, 0.0) + (1e-4 + 1e-5 * last_hit_t()) + reach;
        rayQueryInitializeEXT(query, accelerationStructureEXT(uvec2(scene.tlas)), gl_RayFlagsNoOpaqueEXT,
                              query_params.mask, query_params.origin + start * query_params.direction, 0.0,
                              query_params.direction, end);
        while (rayQueryProceedEXT(query)) {
            uint instance = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, false));
            uint primitive = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, false));
            // Skips other instances that have the same cull mask.
            if (query_params.instance != RELIDAR_NO_INSTANCE && instance != query_params.instance) continue;
            test_instance_surfel(scene, ray, previous_key, instance,
                                 BOXES != 0u ? primitive : primitive / proxy_triangles());
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
}
#endif
