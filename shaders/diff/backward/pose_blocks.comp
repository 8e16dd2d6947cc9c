// SPDX-License-Identifier: Apache-2.0
// First of two kernels that compute gradients of instance poses. Moving a model moves all
// its surfels, so the gradient of its pose is the sum of their gradients as forces and
// torques. This is the chain rule of mean' = R mean + T, axis' = R axis. One workgroup
// sums a block of surfels in a fixed order, so that the result is the same in every run.
// Input: records, d_records, d_view, blocks. Output: sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/backward.h"
#include "pose_sum.glsl"
RELIDAR_PARAMS(PoseBlocksParams);

vec3 load_vec3(Floats array, uint row) { return vec3(array.at[row], array.at[row + 1], array.at[row + 2]); }

/// Returns dL/dw of one surfel, where the rotation vector w rotates the viewing direction
/// by a small angle. The surfel has 16 gradient floats, which start at index
/// `first_float`. Elements 7, 11 and 15 of these floats are dL/dw.
vec3 view_rotation(uint first_float) {
    return vec3(params.d_records.at[first_float + 7], params.d_records.at[first_float + 11],
                params.d_records.at[first_float + 15]);
}

bool is_zero(vec3 vector) { return vector == vec3(0.0); }

/// Adds the gradient of one surfel to the pose gradient of its model. Does not load the
/// records of surfels whose gradient is zero.
void add_surfel(PoseBlock block, uint index_in_block, inout PoseSum sum) {
    uint surfel = block.first_surfel + index_in_block, row = 16u * (block.first_row + index_in_block);
    vec3 d_mean = load_vec3(params.d_records, row), d_axis_u = load_vec3(params.d_records, row + 4u);
    vec3 d_axis_v = load_vec3(params.d_records, row + 8u), d_normal = load_vec3(params.d_records, row + 12u);
    // If a model rotates, the viewing direction rotates the opposite way in the frame of
    // the model. Therefore this gradient is subtracted.
    if (params.sh_per_surfel == 0u) sum.torque -= view_rotation(row);
    else if (block.with_view != 0u) sum.view += load_vec3(params.d_view, 3u * surfel);
    if (is_zero(d_mean) && is_zero(d_axis_u) && is_zero(d_axis_v) && is_zero(d_normal)) return;
    SurfelRecord s = params.records.at[surfel];
    sum.force += d_mean;
    sum.torque += cross(s.mean, d_mean) + cross(s.axis_u, d_axis_u) + cross(s.axis_v, d_axis_v) +
                  cross(s.normal, d_normal);
}

void main() {
    uint i = workgroup_index();
    if (i >= params.n_blocks) return;  // for the full workgroup
    PoseBlock block = params.blocks.at[i];
    PoseSum sum = PoseSum(vec3(0.0), vec3(0.0), vec3(0.0));
    for (uint k = gl_LocalInvocationIndex; k < block.n_surfels; k += gl_WorkGroupSize.x)
        add_surfel(block, k, sum);
    sum = workgroup_sum(sum);
    if (gl_LocalInvocationIndex > 0u) return;
    for (uint k = 0u; k < 3u; ++k) {
        params.sums.at[RELIDAR_POSE_SUMS * i + k] = sum.force[k];
        params.sums.at[RELIDAR_POSE_SUMS * i + 3u + k] = sum.torque[k];
        params.sums.at[RELIDAR_POSE_SUMS * i + 6u + k] = sum.view[k];
    }
}
