// SPDX-License-Identifier: Apache-2.0
// Finds the sensor pose that precedes the firing time of a ray.
#ifndef RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#define RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#include "../shared/place_point.h"

/// Returns the last sensor pose before a time. Before the first pose, returns the first
/// pose. After the last pose, returns the second to last pose, so that the motion between
/// the last two poses continues.
SensorPose find_pose(SensorPoses poses, uint n_poses, float time_offset_s) {
    uint k = 0u, end = max(n_poses, 2u) - 1u;  // binary search, because a client may send many poses
    while (end - k > 1u) {
        uint middle = (k + end) / 2u;
        if (poses.at[middle].time_offset_s <= time_offset_s) k = middle;
        else end = middle;
    }
    return poses.at[k];
}
#endif
