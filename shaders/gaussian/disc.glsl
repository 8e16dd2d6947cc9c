// SPDX-License-Identifier: Apache-2.0
// A surfel with a sharper rim, and its derivative: alpha = sigma exp(-x^2), x = (u^2 + v^2) / 2, where M2 has sigma exp(-x). Within
// x = 1 it is flatter than a surfel, beyond it steeper. Kernels call intersect() of primitive.glsl.
#ifndef RELIDAR_INCLUDED_GAUSSIAN_DISC_GLSL
#define RELIDAR_INCLUDED_GAUSSIAN_DISC_GLSL
#include "surfel.glsl"

bool intersect_disc(SurfelRecord s, vec3 origin, vec3 direction, out SurfelHit hit) {
    bool meets = intersect_surfel(s, origin, direction, hit);
    precise float x = 0.5 * (hit.u * hit.u + hit.v * hit.v);
    precise float alpha = s.opacity * exp(-x * x);
    hit.alpha = alpha;
    return meets && !isnan(hit.alpha);
}

/// The surfel's, with d(x^2) = 2 x dx
SurfelHitGradient intersect_disc_vjp(SurfelRecord s, vec3 origin, vec3 direction, SurfelHit hit, float d_t, float d_alpha) {
    float x = 0.5 * (hit.u * hit.u + hit.v * hit.v);
    SurfelHitGradient g = intersect_surfel_vjp(s, origin, direction, hit, d_t, 2.0 * x * d_alpha);
    g.d_opacity = d_alpha * hit.alpha / s.opacity;
    return g;
}
#endif
