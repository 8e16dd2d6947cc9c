// SPDX-License-Identifier: Apache-2.0
// Computes the gradient of the sensor pose. Moving the sensor has the same effect as
// moving all instances in the opposite direction. Therefore the gradient is minus the sum
// over all instances, with torques about the sensor. One thread. Input: instances,
// d_poses. Output: d_sensor.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/backward.h"
RELIDAR_PARAMS(SensorPoseParams);

vec3 load_vec3(Floats array, uint row) { return vec3(array.at[row], array.at[row + 1], array.at[row + 2]); }

void main() {
    if (thread_index() > 0u) return;
    vec3 force = vec3(0.0), torque = vec3(0.0);
    for (uint i = 0u; i < params.n_instances; ++i) {
        InstanceEntry m = params.instances.at[i];
        // World position of the model's origin: -A^T t. The instance stores
        // model_from_world, which is (A, t), by rows.
        vec3 origin = -(mat3(m.row0.xyz, m.row1.xyz, m.row2.xyz) * vec3(m.row0.w, m.row1.w, m.row2.w));
        vec3 f = load_vec3(params.d_poses, 6u * i);
        force += f;
        // Changes the centre of the torque from the model's origin to the sensor.
        torque += load_vec3(params.d_poses, 6u * i + 3u) + cross(origin - params.view_origin, f);
    }
    for (uint k = 0u; k < 3u; ++k) {
        params.d_sensor.at[k] = -force[k];
        params.d_sensor.at[3u + k] = -torque[k];
    }
}
