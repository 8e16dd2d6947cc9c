// SPDX-License-Identifier: Apache-2.0
// Finds the sensor pose from which the motion at a ray's firing time starts.
#ifndef RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#define RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#include "../shared/place_point.h"

/// Returns the pose from which the motion at a time starts: the last pose before the
/// time. Returns the second to last pose after the last pose, and the first pose before
/// the first pose.
SensorPose pose_before(SensorPoses poses, uint n_poses, float time_offset_s) {
    uint k = 0u;
    while (k + 2u < n_poses && poses.at[k + 1u].time_offset_s <= time_offset_s) ++k;
    return poses.at[k];
}
#endif
