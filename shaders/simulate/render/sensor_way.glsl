// SPDX-License-Identifier: Apache-2.0
// Which pose of a sensor a ray is placed by.
#ifndef RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#define RELIDAR_INCLUDED_SIMULATE_RENDER_SENSOR_WAY_GLSL
#include "../shared/place_point.h"

/// The last pose before a time; beyond the last pose the one before it, and before the
/// first pose the first one.
SensorPose pose_before(SensorPoses poses, uint n_poses, float time_offset_s) {
    uint k = 0u;
    while (k + 2u < n_poses && poses.at[k + 1u].time_offset_s <= time_offset_s) ++k;
    return poses.at[k];
}
#endif
