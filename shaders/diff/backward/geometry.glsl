// SPDX-License-Identifier: Apache-2.0
// Derivatives of what the geometric losses want of a ray (docs/method.md M10-M12), hit by
// hit. With T the transmittance before a hit, T' that behind it and T_N that of the whole
// ray, the weight before a hit is 1 - T, its own T - T' and all of the ray 1 - T_N.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_GEOMETRY_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_GEOMETRY_GLSL
#include "../traversal/facing_normal.glsl"
#include "../traversal/likelihood.glsl"

const bool WITH_GEOMETRY = GEOMETRY != 0u || LIKELIHOOD != 0u;

// Of the ray of this thread, WITH_GEOMETRY.
GeometryGradient ray_geometry;  // dL/d(normal), dL/d(distortion), dL/d(likelihood)
float ray_transmittance;        // T_N

/// Makes them those of a ray of the batch, and what the ray measured. @param gradient
/// its dL/d(geometry)  @param transmittance  its T_N
void take_ray(TraceScene scene, uint ray, GeometryGradient gradient, float transmittance) {
    ray_geometry = gradient;
    ray_transmittance = transmittance;
    if (LIKELIHOOD != 0u) take_measured(scene, ray);
}

/// dDist/dt of a hit: w (weight before it - weight behind it).
/// @param alpha  clamped
float distortion_by_t(float w, float alpha) {
    float before = w / alpha;  // T
    return w * (1.0 + ray_transmittance + w - 2.0 * before);
}

/// dDist/dw of a hit: its distances to all others, weighted.
/// @param beyond  the hit's t less that of the first hit  @param before  the same summed
/// with their weights over the hits before it
/// @param moment  and over all of the ray
float distortion_by_weight(float transmittance, float beyond, float before, float moment) {
    return beyond * (1.0 + ray_transmittance - 2.0 * transmittance) - 2.0 * before + moment;
}
#endif
