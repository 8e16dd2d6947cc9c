// SPDX-License-Identifier: Apache-2.0
// Intersects a ray with a surfel or 3D Gaussian, and computes the derivative. All passes
// and all traversal methods use these functions, so that they sort and blend
// bit-identical distances t.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#include "kinds.glsl"
#include "surfel.glsl"
#include "gaussian3d.glsl"

/// Intersects a ray with a surfel or 3D Gaussian. The caller must compare the resulting
/// alpha with alpha_min.
/// @return false if there is no intersection
bool intersect(SurfelRecord record, vec3 origin, vec3 direction, out SurfelHit hit) {
    if (PRIMITIVE == kPrimitive_gaussian) return hit_gaussian(record, origin, direction, hit);
    return hit_surfel(record, origin, direction, hit);
}

/// Derivative of intersect(): returns gradients of the surfel's record and of the ray.
/// @param d_t dL/dt, where L is the loss and t is the distance of the hit
/// @param d_alpha dL/d(hit.alpha). hit.alpha is alpha before clamping. The caller must
/// pass 0 if it has clamped alpha
SurfelHitGradient intersect_vjp(SurfelRecord record, vec3 origin, vec3 direction, SurfelHit hit, float d_t,
                                float d_alpha) {
    if (PRIMITIVE == kPrimitive_gaussian) return gaussian_vjp(record, origin, direction, hit, d_t, d_alpha);
    return surfel_vjp(record, origin, direction, hit, d_t, d_alpha);
}
#endif
