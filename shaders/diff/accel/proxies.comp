// SPDX-License-Identifier: Apache-2.0
// Computes the proxy geometry of every surfel (docs/method.md M3, Fig. 3), which encloses
// all points with sigma G >= alpha_min: a rectangle (4 corners) for surfels, an
// icosahedron (12 corners) for 3D Gaussians, or an axis-aligned box for both. One thread
// per surfel of a range. Input: records. Maximum: reach. Output: vertices or boxes, in
// the model frame.
//
// Surfels that cannot be hit get a proxy of zero area at their mean, never NaN, because a
// NaN would corrupt neighbouring boxes in the tree. In the software tree they get an
// empty box (low above high). All other boxes grow by the rounding error of their mean.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/accel.h"
#include "../../scene/gaussian/kinds.glsl"
RELIDAR_CONSTANT(uint, BOXES, 0u);
RELIDAR_PARAMS(ProxyParams);

// Golden ratio phi. The corners of an icosahedron are the even permutations of (0, +-1,
// +-phi).
const float kGoldenRatio = 1.618033988749895;
// Scale of an icosahedron whose faces touch the unit sphere: sqrt(3) / phi^2.
const float kCircumscribedScale = 0.66158453824961;
// Distance between the centre and the corners of an icosahedron whose faces touch the
// unit sphere.
const float kOuterRadius = 1.25840857236482;

/// Returns a half axis of the shape that encloses a surfel: parallel to
/// `axis_over_scale`, with the length n_deviations * s * margin_scale + margin_m. s is
/// the standard deviation, m.
/// @param axis_over_scale axis of the surfel: unit vector divided by s, 1/m
vec3 half_axis(vec3 axis_over_scale, float n_deviations) {
    float inverse_scale = length(axis_over_scale);
    float half_size = n_deviations / inverse_scale * params.margin_scale + params.margin_m;
    vec3 half_vector = axis_over_scale / inverse_scale * half_size;
    return any(isnan(half_vector)) || any(isinf(half_vector)) ? vec3(0.0) : half_vector;
}

/// Returns corner `k` of an icosahedron around the origin. Corners are sqrt(1 + phi^2)
/// away from the origin.
vec3 icosahedron_corner(uint k) {
    float one = (k & 1u) != 0u ? -1.0 : 1.0, phi = (k & 2u) != 0u ? -kGoldenRatio : kGoldenRatio;
    if (k < 4u) return vec3(0.0, one, phi);
    if (k < 8u) return vec3(one, phi, 0.0);
    return vec3(phi, 0.0, one);
}

/// Writes the twelve corners of an icosahedron. Their order must match the triangles in
/// src/diff/accel/hardware.cpp.
void write_corners(uint index, vec3 mean, vec3 axis_u, vec3 axis_v, vec3 axis_w) {
    for (uint k = 0u; k < 12u; ++k) {
        vec3 at = icosahedron_corner(k);
        vec3 corner = mean + kCircumscribedScale * (at.x * axis_u + at.y * axis_v + at.z * axis_w);
        for (uint c = 0u; c < 3u; ++c) params.vertices.at[36u * index + 3u * k + c] = corner[c];
    }
    float reach =
        (1.0 + kOuterRadius) * sqrt(max(max(dot(axis_u, axis_u), dot(axis_v, axis_v)), dot(axis_w, axis_w)));
    if (reach > 0.0) atomicMax(params.reach.at[0], floatBitsToUint(reach));
}

void main() {
    uint i = params.first_surfel + thread_index();
    if (thread_index() >= params.n_surfels) return;
    SurfelRecord s = params.records.at[i];
    vec3 u = vec3(0.0), v = vec3(0.0), w = vec3(0.0);
    bool visible = s.opacity > params.alpha_min;
    if (visible) {
        // At k standard deviations, sigma exp(-k^2 / 2) = alpha_min.
        float k = sqrt(2.0 * log(s.opacity / params.alpha_min));
        u = half_axis(s.axis_u, k);
        v = half_axis(s.axis_v, k);
        if (has_third_axis()) w = half_axis(s.normal, k);
    }
    if (BOXES != 0u) {
        // Half size of the axis-aligned box around an ellipsoid with half axes u, v, w.
        vec3 half_size = sqrt(u * u + v * v + w * w) + (visible ? params.margin_m : 0.0);
        // Software tree (BOXES = 2): adds a bound of the mean's rounding error.
        if (BOXES == 2u) half_size += 2.4e-7 * abs(s.mean);
        bool empty = BOXES == 2u && !visible;
        for (uint c = 0u; c < 3u; ++c) {
            params.boxes.at[6 * i + c] = empty ? 3.4e38 : s.mean[c] - half_size[c];
            params.boxes.at[6 * i + 3 + c] = empty ? -3.4e38 : s.mean[c] + half_size[c];
        }
        return;
    }
    if (proxy_triangles() == kProxy_icosahedron) {
        write_corners(i, s.mean, u, v, w);
        return;
    }
    vec3 corner[4] = vec3[](s.mean - u - v, s.mean + u - v, s.mean + u + v, s.mean - u + v);
    for (uint k = 0u; k < 4u; ++k)
        for (uint c = 0u; c < 3u; ++c) params.vertices.at[12 * i + 3 * k + c] = corner[k][c];
}
