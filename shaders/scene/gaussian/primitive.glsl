// SPDX-License-Identifier: Apache-2.0
// The one ray-primitive function of the program and its derivative, for whichever
// primitive the scene is made of. Every pass, forward and backward, every backend sorts
// and blends the t computed here, from the original ray.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_PRIMITIVE_GLSL
#include "kinds.glsl"
#include "surfel.glsl"
#include "gaussian3d.glsl"

/// @return whether the ray meets it; alpha is not compared with anything
bool intersect(SurfelRecord s, vec3 origin, vec3 direction, out SurfelHit hit) {
    if (PRIMITIVE == kPrimitive_gaussian) return intersect_gaussian(s, origin, direction, hit);
    return intersect_surfel(s, origin, direction, hit);
}

/// @param d_t      dL/dt at fixed alpha
/// @param d_alpha  dL/d(sigma G); 0 where alpha was clamped
SurfelHitGradient intersect_vjp(SurfelRecord s, vec3 origin, vec3 direction, SurfelHit hit, float d_t,
                                float d_alpha) {
    if (PRIMITIVE == kPrimitive_gaussian)
        return intersect_gaussian_vjp(s, origin, direction, hit, d_t, d_alpha);
    return intersect_surfel_vjp(s, origin, direction, hit, d_t, d_alpha);
}
#endif
