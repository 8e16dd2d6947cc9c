// SPDX-License-Identifier: Apache-2.0
// Interpolates between the sensor poses before and after the firing time of a ray.
// Include this file after shared/train.h.
#ifndef RELIDAR_INCLUDED_TRAIN_KNOTS_GLSL
#define RELIDAR_INCLUDED_TRAIN_KNOTS_GLSL

/// Returns the sensor pose at the firing time of a ray, interpolated between two poses.
PoseKnot sensor_pose(PoseKnots knots, PoseInterpolation interpolation) {
    PoseKnot a = knots.at[interpolation.left];
    // If the next pose has the weight 0, it may not exist.
    if (interpolation.s == 0.0) return a;
    PoseKnot b = knots.at[interpolation.left + 1u];
    return PoseKnot(mix(a.position, b.position, interpolation.s),
                    mix(a.translation, b.translation, interpolation.s),
                    mix(a.rotation, b.rotation, interpolation.s));
}
#endif
