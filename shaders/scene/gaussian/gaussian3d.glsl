// SPDX-License-Identifier: Apache-2.0
// Intersection of a ray with a 3D Gaussian (docs/method.md M9), and its derivative. The
// hit is the point of highest density along the ray, which is the point nearest to the
// mean if distances are measured in standard deviations. The record stores the rows of A
// = (a_u / s_u, a_v / s_v, a_w / s_w). With a = A (mean - o), b = A d:
//   t = a.b / b.b,  q = A (o + t d - mean),  G = exp(-|q|^2 / 2)
//
// q is computed from the rounded t. Then the point at t is inside the ellipsoid alpha >=
// alpha_min and inside every proxy shape around it. Therefore every traversal finds the
// hit.
//
// Exact arithmetic gives q . b = 0, so any component of q along b is a rounding error and
// is removed. The removed part is at most kMaxRounding_m along the ray, which is half of
// the margin of the proxies. At 50 m, the rounding error is about 3e-6 m. Without this
// correction, it would add noise to the opacity of Gaussians thinner than 1e-4 m.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_GAUSSIAN3D_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_GAUSSIAN3D_GLSL

const float kMaxRounding_m = 5e-5;

/// Divides the components of a vector along the Gaussian's axes by their standard
/// deviations.
vec3 whiten_vector(SurfelRecord record, vec3 vector) {
    return vec3(exact_dot(record.axis_u, vector), exact_dot(record.axis_v, vector),
                exact_dot(record.normal, vector));
}

/// Intersects a ray with a 3D Gaussian.
/// @param origin  origin of the ray, model frame, m
/// @param direction  direction of the ray, model frame, unit length
/// @return false if a value is not finite
bool hit_gaussian(SurfelRecord record, vec3 origin, vec3 direction, out SurfelHit hit) {
    precise vec3 to_mean = record.mean - origin;
    vec3 b = whiten_vector(record, direction);
    float length2 = exact_dot(b, b);
    precise float t = exact_dot(whiten_vector(record, to_mean), b) / length2;
    precise vec3 p = t * direction - to_mean;
    vec3 q = whiten_vector(record, p);
    precise float off = clamp(exact_dot(q, b) / length2, -kMaxRounding_m, kMaxRounding_m);
    precise vec3 at_rest = q - off * b;
    hit.t = t;
    hit.u = at_rest.x;
    hit.v = at_rest.y;
    hit.w = at_rest.z;
    precise float alpha = record.opacity * exp(-0.5 * exact_dot(at_rest, at_rest));
    hit.alpha = alpha;
    return length2 > 0.0 && !isinf(t) && !isnan(t) && !isnan(hit.alpha);
}

/// Derivative of hit_gaussian(). The top of this file defines a, b, q and G. alpha
/// = sigma G, where sigma is the opacity. Because q is perpendicular to b, |q|^2 does not
/// depend on t:
///   dalpha = -alpha q . dq with t held constant,  dt = (b . da - (q + t b) . db) / b.b
/// @param d_t dL/dt at fixed alpha
/// @param d_alpha dL/d(alpha). Must be 0 if alpha was clamped
SurfelHitGradient gaussian_vjp(SurfelRecord record, vec3 origin, vec3 direction, SurfelHit hit, float d_t,
                               float d_alpha) {
    SurfelHitGradient g;
    vec3 q = vec3(hit.u, hit.v, hit.w);
    vec3 p = hit.t * direction - (record.mean - origin);
    vec3 b = whiten_vector(record, direction);
    float e = d_t / dot(b, b);
    vec3 d_point = -d_alpha * hit.alpha * q - e * b;  // dL/d(A (o - mean))
    vec3 d_mean = -(d_point.x * record.axis_u + d_point.y * record.axis_v + d_point.z * record.normal);
    g.d_mean = d_mean;
    g.d_axis_u = d_point.x * p - e * q.x * direction;
    g.d_axis_v = d_point.y * p - e * q.y * direction;
    g.d_normal = d_point.z * p - e * q.z * direction;
    g.d_opacity = d_alpha * hit.alpha / record.opacity;
    g.d_origin = -d_mean;
    g.d_direction = -hit.t * d_mean - e * (q.x * record.axis_u + q.y * record.axis_v + q.z * record.normal);
    return g;
}
#endif
