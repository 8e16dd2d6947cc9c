// SPDX-License-Identifier: Apache-2.0
// Applies the pose corrections of the sensor to the rays of a frame. Each ray rotates by
// w around the sensor position c at its firing time, and moves by v:
//   origin' = c + exp([w]x) (origin - c) + v,   direction' = exp([w]x) direction
//
// One thread per ray. Input: rays, interpolations, knots. Output: moved.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "../base/shared/rotation.h"
#include "shared/train.h"
#include "knots.glsl"
RELIDAR_PARAMS(MoveRaysParams);

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    PoseKnot knot = sensor_pose(params.knots, params.interpolations.at[i]);
    DeviceRay ray = params.rays.at[i];
    params.moved.at[i] =
        DeviceRay(knot.position + rotate_point(knot.rotation, ray.origin - knot.position) + knot.translation,
                  normalize(rotate_point(knot.rotation, ray.direction)), ray.time_s);
}
