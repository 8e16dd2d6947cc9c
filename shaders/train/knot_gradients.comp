// SPDX-License-Identifier: Apache-2.0
// From gradients of rays to those of the sensor poses between which they were fired, by the weights of the interpolation:
//   dL/dv = dL/d(origin),   dL/dw = (origin - c) x dL/d(origin) + direction x dL/d(direction),   c the corrected position of the sensor
// One thread a lane and knot, which sums every n_lanes-th ray in order. Input: moved, places, knots, d_rays. Output: rows.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/train.h"
#include "knots.glsl"
RELIDAR_PARAMS(KnotGradientsParams);

/// Where the batch's ray k is among the rays of the frame.
uint frame_ray(uint k) {
    if (params.columns == 0u) return params.first_ray + k * params.ray_stride;
    return k / params.n_columns * params.columns + (params.first_column + k % params.n_columns * params.column_stride) % params.columns;
}

vec3 load3(Floats a, uint i) { return vec3(a.at[i], a.at[i + 1u], a.at[i + 2u]); }

void main() {
    uint i = thread_index(), lane = i / params.n_knots, knot = i % params.n_knots;
    if (lane >= params.n_lanes) return;
    vec3 force = vec3(0.0), torque = vec3(0.0);
    for (uint k = lane; k < params.n_rays; k += params.n_lanes) {
        RayPlace place = params.places.at[frame_ray(k)];
        float share = knot == place.left ? 1.0 - place.s : knot == place.left + 1u ? place.s : 0.0;
        if (share == 0.0) continue;
        PoseKnot here = knot_at(params.knots, place);
        RayEntry ray = params.moved.at[params.first_ray + k * params.ray_stride];
        vec3 d_origin = load3(params.d_rays, 6u * k);
        force += share * d_origin;
        torque += share * (cross(ray.origin - here.position - here.translation, d_origin) + cross(ray.direction, load3(params.d_rays, 6u * k + 3u)));
    }
    for (uint j = 0u; j < 3u; ++j) {
        params.rows.at[6u * i + j] = force[j];
        params.rows.at[6u * i + 3u + j] = torque[j];
    }
}
