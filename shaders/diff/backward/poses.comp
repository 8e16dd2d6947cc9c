// SPDX-License-Identifier: Apache-2.0
// Second of two kernels that compute gradients of instance poses. Sums the blocks of each
// instance and adds the gradient of the view origin, which moves relative to the model.
// Then rotates the result into the world frame. A pose correction means:
//   world_from_model becomes (exp([rotation]x) R, T + translation)
//
// One workgroup sums the blocks of one instance in a fixed order. Input: instances, sums,
// first_block. Output: d_poses.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/backward.h"
#include "pose_sum.glsl"
RELIDAR_PARAMS(PosesParams);

vec3 load_vec3(Floats array, uint row) { return vec3(array.at[row], array.at[row + 1], array.at[row + 2]); }

void main() {
    uint i = workgroup_index();
    if (i >= params.n_instances) return;  // for the full workgroup
    PoseSum sum = PoseSum(vec3(0.0), vec3(0.0), vec3(0.0));
    for (uint b = params.first_block.at[i] + gl_LocalInvocationIndex; b < params.first_block.at[i + 1u];
         b += gl_WorkGroupSize.x) {
        sum.force += load_vec3(params.sums, RELIDAR_POSE_SUMS * b);
        sum.torque += load_vec3(params.sums, RELIDAR_POSE_SUMS * b + 3u);
        sum.view += load_vec3(params.sums, RELIDAR_POSE_SUMS * b + 6u);
    }
    sum = workgroup_sum(sum);
    if (gl_LocalInvocationIndex > 0u) return;
    InstanceEntry m = params.instances.at[i];
    vec4 eye = vec4(params.view_origin, 1.0);
    sum.torque -= cross(vec3(dot(m.row0, eye), dot(m.row1, eye), dot(m.row2, eye)), sum.view);
    sum.force -= sum.view;
    // The instance stores model_from_world by rows. Used as columns, these rows give the
    // inverse rotation.
    mat3 world_from_model = mat3(m.row0.xyz, m.row1.xyz, m.row2.xyz);
    vec3 translation = world_from_model * sum.force, rotation = world_from_model * sum.torque;
    for (uint k = 0u; k < 3u; ++k) {
        params.d_poses.at[6u * i + k] = translation[k];
        params.d_poses.at[6u * i + 3u + k] = rotation[k];
    }
}
