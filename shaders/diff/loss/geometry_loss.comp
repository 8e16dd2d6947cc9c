// SPDX-License-Identifier: Apache-2.0
// Geometric losses on rays with a return (docs/method.md M10-M12): distortion along the
// ray; W - B . N, the disagreement of the blended surfel normals B with the normal N of
// the rendered range image; and the likelihood of the measured range given the hits. One
// thread per ray. Input: rays, rendered, geometry, targets. Output: d_geometry (except
// its point), d_tangents. Accumulated: upstream, terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_shader_atomic_float : enable
#include "../../base/kernel.glsl"
#include "../shared/geometry_loss.h"
#include "../../base/atomic_add.glsl"
#include "../../base/reduce.glsl"
RELIDAR_PARAMS(GeometryLossParams);
#include "range_image.glsl"

// Limit of the change of inverse ranges. A step by a tenth of the range is an edge.
const float kLargestBend = 0.1;
const float kLeastSine = 0.05;  // minimum sine between the tangents; below, their plane is ill-defined

/// Returns true if the pixels on both sides of pixel i are on the same surface. The test
/// uses 1 / r, which is linear along a plane of any inclination.
bool continues(uint a, uint i, uint b) {
    if (a == kNoPixel || b == kNoPixel || !is_surface(a) || !is_surface(b)) return false;
    float r = image_range(i);
    return abs(r / image_range(a) + r / image_range(b) - 2.0) < kLargestBend;
}

vec3 chord(uint from, uint to) {
    DeviceRay a = ray_of(from), b = ray_of(to);
    return (b.origin - a.origin) + (image_range(to) * b.direction - image_range(from) * a.direction);
}

/// Computes the term of pixel i and its derivatives.
/// @return the term
float normal_term(uint i, inout GeometryGradient g) {
    uint left = pixel_at(i, 0, -1), right = pixel_at(i, 0, 1), above = pixel_at(i, -1, 0),
         below = pixel_at(i, 1, 0);
    if (!is_surface(i) || !continues(left, i, right) || !continues(above, i, below)) return 0.0;
    vec3 across = chord(left, right), down = chord(above, below), area = cross(across, down);
    float size = length(area);
    if (!(size > kLeastSine * length(across) * length(down))) return 0.0;
    // N faces the sensor, like the surfel normals
    float side = dot(area, ray_of(i).direction) > 0.0 ? -1.0 : 1.0;
    vec3 normal = side / size * area, blended = params.geometry.at[i].normal;
    float cosine = dot(normal, blended);
    g.normal = -params.normal_weight * normal;
    params.upstream.at[i].weight += params.normal_weight;
    vec3 d_area = -params.normal_weight * side / size * (blended - cosine * normal);
    params.d_tangents.at[2u * i] = cross(down, d_area);
    params.d_tangents.at[2u * i + 1u] = cross(d_area, across);
    return params.normal_weight * (params.rendered.at[i].weight - cosine);
}

/// Computes the two terms that depend on a single ray with a return: distortion, and
/// -ln(floor + (1 - floor) S).
vec2 ray_terms(uint i, inout GeometryGradient g) {
    RenderedGeometry q = params.geometry.at[i];
    float explained = params.likelihood_floor + (1.0 - params.likelihood_floor) * q.likelihood;
    g.distortion = params.distortion_weight;
    g.likelihood = -params.likelihood_weight * (1.0 - params.likelihood_floor) / explained;
    return vec2(params.distortion_weight * q.distortion, -params.likelihood_weight * log(explained));
}

void main() {
    uint i = thread_index();
    vec3 terms = vec3(0.0);
    if (i < params.n_rays) {
        GeometryGradient g = GeometryGradient(vec3(0.0), 0.0, vec3(0.0), 0.0, 0.0);
        if (returned(i)) terms.xz = ray_terms(i, g);
        if (params.normal_weight > 0.0) {
            params.d_tangents.at[2u * i] = params.d_tangents.at[2u * i + 1u] = vec3(0.0);
            terms.y = normal_term(i, g);
        }
        params.d_geometry.at[i] = g;
    }
    if (params.distortion_weight > 0.0) add_to_sum(params.terms, kTerm_distortion, terms.x);
    if (params.normal_weight > 0.0) add_to_sum(params.terms, kTerm_normal, terms.y);
    if (params.likelihood_weight > 0.0) add_to_sum(params.terms, kTerm_likelihood, terms.z);
}
