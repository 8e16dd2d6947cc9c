// SPDX-License-Identifier: Apache-2.0
// Proxy geometry of every surfel (M3, Fig. 3): corners of the rectangle that holds sigma G >= alpha_min, or its box. One thread a
// surfel. Input: records. Output: vertices (two co-planar triangles share four corners) or boxes, model frame.
// Surfels that cannot be hit get a proxy of no area at their mean; never a NaN, which would poison its neighbours in the tree. The boxes
// of the software structure are empty there (low above high), and grow by the last digits of a mean far from the origin.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/accel.h"
layout(constant_id = 2) const uint BOXES = 0u;   // 1: for a driver, 2: for the software structure
RELIDAR_PARAMS(ProxyParams);

/// Half axis of the proxy along a record axis a / s: direction a, length k s grown by the margin.
vec3 half_axis(vec3 axis, float k) {
    float inverse_scale = length(axis);
    float half_size = k / inverse_scale * params.margin_scale + params.margin_m;
    vec3 half_vector = axis / inverse_scale * half_size;
    return any(isnan(half_vector)) || any(isinf(half_vector)) ? vec3(0.0) : half_vector;
}

void main() {
    uint i = thread_index();
    if (i >= params.n_surfels) return;
    SurfelRecord s = params.records.at[i];
    vec3 u = vec3(0.0), v = vec3(0.0);
    bool visible = s.opacity > params.alpha_min;
    if (visible) {
        float k = sqrt(2.0 * log(s.opacity / params.alpha_min));
        u = half_axis(s.axis_u, k);
        v = half_axis(s.axis_v, k);
    }
    if (BOXES != 0u) {
        // The box of the ellipse, not of the rectangle: half size along x is |(u.x, v.x)|, the tightest there is.
        vec3 half_size = sqrt(u * u + v * v) + (visible ? params.margin_m : 0.0);
        if (BOXES == 2u) half_size += 2.4e-7 * abs(s.mean);
        bool empty = BOXES == 2u && !visible;
        for (uint c = 0u; c < 3u; ++c) {
            params.boxes.at[6 * i + c] = empty ? 3.4e38 : s.mean[c] - half_size[c];
            params.boxes.at[6 * i + 3 + c] = empty ? -3.4e38 : s.mean[c] + half_size[c];
        }
        return;
    }
    vec3 corner[4] = vec3[](s.mean - u - v, s.mean + u - v, s.mean + u + v, s.mean - u + v);
    for (uint k = 0u; k < 4u; ++k)
        for (uint c = 0u; c < 3u; ++c) params.vertices.at[12 * i + 3 * k + c] = corner[k][c];
}
