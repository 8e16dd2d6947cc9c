// SPDX-License-Identifier: Apache-2.0
// Interpolates between the sensor poses before and after the firing time of a ray.
// Include this file after shared/train.h.
#ifndef RELIDAR_INCLUDED_TRAIN_KNOTS_GLSL
#define RELIDAR_INCLUDED_TRAIN_KNOTS_GLSL

PoseKnot interpolate_knot(PoseKnots knots, RayPlace place) {
    PoseKnot a = knots.at[place.left];
    // If the next pose has the weight 0, it may not exist.
    if (place.s == 0.0) return a;
    PoseKnot b = knots.at[place.left + 1u];
    return PoseKnot(mix(a.position, b.position, place.s), mix(a.translation, b.translation, place.s),
                    mix(a.rotation, b.rotation, place.s));
}
#endif
