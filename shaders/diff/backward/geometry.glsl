// SPDX-License-Identifier: Apache-2.0
// Derivatives of a ray's geometric losses (docs/method.md M10-M12) with respect to each
// hit. With the transmittance T before a hit, T' behind it and T_N of the full ray, the
// weight before a hit is 1 - T, the weight of the hit is T - T', and the weight of the
// ray is 1 - T_N.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_GEOMETRY_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_GEOMETRY_GLSL
#include "../traversal/facing_normal.glsl"
#include "../traversal/likelihood.glsl"

const bool WITH_GEOMETRY = GEOMETRY != 0u || LIKELIHOOD != 0u;

// Values of this thread's ray, if WITH_GEOMETRY is set.
GeometryGradient ray_geometry;  // dL/d(normal), dL/d(distortion), dL/d(likelihood)
float ray_transmittance;        // T_N

/// Sets the geometry gradient and the measurement of a ray of the batch.
/// @param gradient  dL/d(geometry) of the ray
/// @param transmittance  T_N of the ray
void take_ray(TraceScene scene, uint ray, GeometryGradient gradient, float transmittance) {
    ray_geometry = gradient;
    ray_transmittance = transmittance;
    if (LIKELIHOOD != 0u) take_measured(scene, ray);
}

/// Returns dDist/dt of a hit: w (weight before it - weight behind it).
/// @param alpha  clamped
float distortion_by_t(float w, float alpha) {
    float before = w / alpha;  // T
    return w * (1.0 + ray_transmittance + w - 2.0 * before);
}

/// Returns dDist/dw of a hit: the weighted sum of its distances to all other hits.
/// @param beyond  distance of the hit behind the first hit
/// @param before  weighted sum of `beyond` over the hits before it
/// @param moment  weighted sum of `beyond` over all hits of the ray
float distortion_by_weight(float transmittance, float beyond, float before, float moment) {
    return beyond * (1.0 + ray_transmittance - 2.0 * transmittance) - 2.0 * before + moment;
}
#endif
