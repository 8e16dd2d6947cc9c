// SPDX-License-Identifier: Apache-2.0
// Converts gradients of rays to gradients of the sensor poses. Each ray was fired between
// two poses, and the interpolation weights distribute its gradient. c is the corrected
// position of the sensor:
//   dL/dv = dL/d(origin)
//   dL/dw = (origin - c) x dL/d(origin) + direction x dL/d(direction)
//
// One workgroup processes one output row of one pose. Thread k of n sums every n-th ray,
// starting with ray k. Then the workgroup adds the sums of its threads, always in the
// same order. Input: moved, interpolations, knots, d_rays. Output: rows.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/train.h"
#include "columns.glsl"
#include "knots.glsl"
RELIDAR_PARAMS(KnotGradientsParams);
shared vec3 forces[RELIDAR_KNOT_WORKGROUP], torques[RELIDAR_KNOT_WORKGROUP];

/// Returns the index in the complete frame of ray `batch_ray` of the batch.
uint frame_ray(uint batch_ray) {
    if (params.columns == 0u) return params.first_ray + batch_ray * params.ray_stride;
    return batch_ray / params.n_columns * params.columns + frame_column(batch_ray % params.n_columns,
                                                                        params.first_column,
                                                                        params.column_stride, params.columns);
}

vec3 load_vec3(Floats array, uint row) { return vec3(array.at[row], array.at[row + 1u], array.at[row + 2u]); }

/// Returns the weight of a sensor pose in an interpolated pose. 0 if the ray was not
/// fired next to it.
float knot_weight(PoseInterpolation interpolation, uint knot) {
    if (knot == interpolation.left) return 1.0 - interpolation.s;
    return knot == interpolation.left + 1u ? interpolation.s : 0.0;
}

/// Sums the gradients of sensor pose `knot` over every `ray_step`-th ray, starting with
/// ray `first_ray`. `d_translation` is dL/d(translation) and `d_rotation` is
/// dL/d(rotation).
void sum_gradients(uint first_ray, uint ray_step, uint knot, out vec3 d_translation, out vec3 d_rotation) {
    d_translation = d_rotation = vec3(0.0);
    for (uint k = first_ray; k < params.n_rays; k += ray_step) {
        PoseInterpolation interpolation = params.interpolations.at[frame_ray(k)];
        float weight = knot_weight(interpolation, knot);
        if (weight == 0.0) continue;
        PoseKnot here = sensor_pose(params.knots, interpolation);
        DeviceRay ray = params.moved.at[params.first_ray + k * params.ray_stride];
        vec3 d_origin = load_vec3(params.d_rays, 6u * k);
        d_translation += weight * d_origin;
        d_rotation += weight * (cross(ray.origin - here.position - here.translation, d_origin) +
                                cross(ray.direction, load_vec3(params.d_rays, 6u * k + 3u)));
    }
}

void main() {
    uint group = workgroup_index(), local = gl_LocalInvocationID.x;
    // One workgroup per row and knot (sensor pose).
    uint row = group / params.n_knots, knot = group % params.n_knots;
    sum_gradients(row * RELIDAR_KNOT_WORKGROUP + local, params.n_rows * RELIDAR_KNOT_WORKGROUP, knot,
                  forces[local], torques[local]);
    // Adds the second half of the sums to the first half until one sum remains.
    for (uint n = RELIDAR_KNOT_WORKGROUP / 2u; n > 0u; n /= 2u) {
        barrier();
        if (local < n) {
            forces[local] += forces[local + n];
            torques[local] += torques[local + n];
        }
    }
    if (local != 0u || row >= params.n_rows) return;
    for (uint j = 0u; j < 3u; ++j) {
        params.rows.at[6u * group + j] = forces[0][j];
        params.rows.at[6u * group + 3u + j] = torques[0][j];
    }
}
