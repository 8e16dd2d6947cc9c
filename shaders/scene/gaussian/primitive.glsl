// SPDX-License-Identifier: Apache-2.0
// Intersection of a ray with a surfel or 3D Gaussian, and its derivative. All passes and
// all traversal backends use these functions. Therefore they sort and blend the same
// distance t.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#include "kinds.glsl"
#include "surfel.glsl"
#include "gaussian3d.glsl"

/// Intersects a ray with a surfel or 3D Gaussian. Does not compare alpha with a
/// threshold.
/// @return true if the ray hits the primitive
bool intersect(SurfelRecord s, vec3 origin, vec3 direction, out SurfelHit hit) {
    if (PRIMITIVE == kPrimitive_gaussian) return intersect_gaussian(s, origin, direction, hit);
    return intersect_surfel(s, origin, direction, hit);
}

/// Derivative of intersect().
/// @param d_t      dL/dt at fixed alpha
/// @param d_alpha  dL/d(sigma G). Must be 0 if alpha was clamped.
SurfelHitGradient intersect_vjp(SurfelRecord s, vec3 origin, vec3 direction, SurfelHit hit, float d_t,
                                float d_alpha) {
    if (PRIMITIVE == kPrimitive_gaussian)
        return intersect_gaussian_vjp(s, origin, direction, hit, d_t, d_alpha);
    return intersect_surfel_vjp(s, origin, direction, hit, d_t, d_alpha);
}
#endif
