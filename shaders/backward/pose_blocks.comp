// SPDX-License-Identifier: Apache-2.0
// Gradients of instance poses, first half: moving a model moves its surfels, so the gradient of its pose is the sum of its record
// gradients as forces and torques (the chain rule of mean' = R mean + T, axis' = R axis). One thread a block of surfels, summed in
// their order: the result is the same in every run.
// Input: records, d_records, d_view, blocks. Output: sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../common/kernel.glsl"
#include "../shared/backward.h"
RELIDAR_PARAMS(PoseBlocksParams);

vec3 load3(Floats a, uint i) { return vec3(a.at[i], a.at[i + 1], a.at[i + 2]); }

/// SH directions turn against the model (their gradient is in lanes 7, 11, 15 where SH are evaluated a hit).
vec3 turn(uint row) { return vec3(params.d_records.at[row + 7], params.d_records.at[row + 11], params.d_records.at[row + 15]); }

void main() {
    uint i = thread_index();
    if (i >= params.n_blocks) return;
    PoseBlock block = params.blocks.at[i];
    vec3 force = vec3(0.0), torque = vec3(0.0), view = vec3(0.0);
    for (uint k = 0u; k < block.n_surfels; ++k) {
        uint surfel = block.first_surfel + k, row = 16u * (block.first_row + k);
        SurfelRecord s = params.records.at[surfel];
        vec3 d_mean = load3(params.d_records, row);
        force += d_mean;
        torque += cross(s.mean, d_mean) + cross(s.axis_u, load3(params.d_records, row + 4u)) + cross(s.axis_v, load3(params.d_records, row + 8u)) +
                  cross(s.normal, load3(params.d_records, row + 12u));
        if (params.sh_per_surfel == 0u) torque -= turn(row);
        else if (block.with_view != 0u) view += load3(params.d_view, 3u * surfel);
    }
    for (uint k = 0u; k < 3u; ++k) {
        params.sums.at[RELIDAR_POSE_SUMS * i + k] = force[k];
        params.sums.at[RELIDAR_POSE_SUMS * i + 3u + k] = torque[k];
        params.sums.at[RELIDAR_POSE_SUMS * i + 6u + k] = view[k];
    }
}
