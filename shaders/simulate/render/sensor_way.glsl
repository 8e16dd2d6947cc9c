// SPDX-License-Identifier: Apache-2.0
// Selects the pose of a sensor that precedes a ray.
#ifndef RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#define RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#include "../shared/place_point.h"

/// Returns the last pose before a time. After the last pose, returns the second to last,
/// because motion is stored with the pose that it starts from. Before the first pose,
/// returns the first.
SensorPose pose_before(SensorPoses poses, uint n_poses, float time_offset_s) {
    uint k = 0u;
    while (k + 2u < n_poses && poses.at[k + 1u].time_offset_s <= time_offset_s) ++k;
    return poses.at[k];
}
#endif
