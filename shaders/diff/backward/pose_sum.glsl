// SPDX-License-Identifier: Apache-2.0
// Adds forces and torques over a workgroup in a fixed order, so that the result is the
// same in every run. Include this file after kernel.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_POSE_SUM_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_POSE_SUM_GLSL

struct PoseSum {
    vec3 force;
    vec3 torque;  // about the model's origin
    vec3 view;    // dL/d(view origin)
};
shared PoseSum pose_partial[gl_WorkGroupSize.x];  // the size is a power of two

/// Returns the sum over all threads of the workgroup, but only to the first thread. Every
/// thread of the workgroup must call this function.
PoseSum workgroup_sum(PoseSum sum) {
    uint lane = gl_LocalInvocationIndex;
    pose_partial[lane] = sum;
    for (uint n = gl_WorkGroupSize.x / 2u; n > 0u; n /= 2u) {
        barrier();
        if (lane >= n) continue;
        pose_partial[lane].force += pose_partial[lane + n].force;
        pose_partial[lane].torque += pose_partial[lane + n].torque;
        pose_partial[lane].view += pose_partial[lane + n].view;
    }
    return pose_partial[lane];
}
#endif
