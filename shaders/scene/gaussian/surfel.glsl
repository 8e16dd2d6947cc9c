// SPDX-License-Identifier: Apache-2.0
// Intersection of a ray with a surfel, and its derivative. The keyword `precise` makes
// the distance t and alpha bit-identical in every kernel. Kernels call intersect() in
// primitive.glsl, which calls these functions.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_SURFEL_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_SURFEL_GLSL

/// Result of intersecting a ray with a surfel or 3D Gaussian, in the frame of its model.
struct SurfelHit {
    float t;  // m along the ray
    // Position of the hit along the surfel's axes, in standard deviations. w is used only
    // for 3D Gaussians and is 0 for surfels.
    float u, v, w;
    float alpha;  // opacity at the hit: sigma G, before it is clamped
};

float exact_dot(vec3 a, vec3 b) {
    precise float sum = a.x * b.x + a.y * b.y + a.z * b.z;
    return sum;
}

/// Intersects a ray with a surfel.
/// @param origin  origin of the ray, model frame, m
/// @param direction  direction of the ray, model frame
/// @return false if the ray is parallel to the surfel's plane (n . d = 0) or a value is
/// not finite
bool hit_surfel(SurfelRecord record, vec3 origin, vec3 direction, out SurfelHit hit) {
    precise vec3 to_mean = record.mean - origin;
    precise float facing = exact_dot(record.normal, direction);
    precise float t = exact_dot(record.normal, to_mean) / facing;
    precise vec3 p = t * direction - to_mean;
    hit.t = t;
    hit.u = exact_dot(record.axis_u, p);
    hit.v = exact_dot(record.axis_v, p);
    hit.w = 0.0;
    precise float exponent = -0.5 * (hit.u * hit.u + hit.v * hit.v);
    precise float alpha = record.opacity * exp(exponent);
    hit.alpha = alpha;
    return facing != 0.0 && !isinf(t) && !isnan(t) && !isnan(hit.alpha);
}

/// Gradient of the loss with respect to a surfel's record and to the ray that hits it.
struct SurfelHitGradient {
    vec3 d_mean;
    vec3 d_axis_u;
    vec3 d_axis_v;
    vec3 d_normal;
    float d_opacity;
    vec3 d_origin;  // origin of the ray, model frame
    vec3 d_direction;
};

/// Derivative of hit_surfel(): gradients of the surfel record and of the ray.
/// @param d_t dL/dt at fixed u, v
/// @param d_alpha dL/d(hit.alpha). Must be 0 if the caller has clamped alpha
SurfelHitGradient surfel_vjp(SurfelRecord record, vec3 origin, vec3 direction, SurfelHit hit, float d_t,
                             float d_alpha) {
    SurfelHitGradient g;
    vec3 p = hit.t * direction - (record.mean - origin);
    float d_u = -d_alpha * hit.alpha * hit.u;
    float d_v = -d_alpha * hit.alpha * hit.v;
    vec3 d_p = d_u * record.axis_u + d_v * record.axis_v;
    d_t += dot(d_p, direction);
    vec3 dt_dmean = record.normal / dot(record.normal, direction);  // dt/d(mean) = n / (n . d)
    g.d_opacity = d_alpha * hit.alpha / record.opacity;
    g.d_axis_u = d_u * p;
    g.d_axis_v = d_v * p;
    g.d_normal = -d_t * p / dot(record.normal, direction);  // dt/dn = (mean - p_hit) / (n . d)
    g.d_mean = d_t * dt_dmean - d_p;
    g.d_origin = d_p - d_t * dt_dmean;
    g.d_direction = hit.t * (d_p - d_t * dt_dmean);
    return g;
}
#endif
