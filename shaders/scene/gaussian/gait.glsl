// SPDX-License-Identifier: Apache-2.0
// Periodic motion of surfels on actors that change their shape, for example pedestrians
// (docs/method.md M14). p is the phase of the actor's motion, and `phase` is the phase at
// which the surfel is most visible. The opacity of the surfel is multiplied by
//   exp(sharpness^2 (cos 2 pi (p - phase) - 1))
//
// and its mean is moved by swing sin 2 pi (p - phase). Include this file after
// shared/scene.h.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_GAIT_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_GAIT_GLSL

struct PeriodicMotion {
    float sharpness;
    vec3 swing;  // amplitude of the motion, m
    float sine;  // sine of 2 pi (p - phase)
    float cosine;
    float less;      // cosine of 2 pi (p - phase), minus 1
    float presence;  // factor that multiplies the opacity
};

const float kTwoPi = 6.283185307;

/// Returns how a periodic motion, for example walking, changes a surfel: its displacement
/// and its visibility.
/// @param actor_phase phase of the actor's motion, 0 to 1. Negative: the model is rigid,
/// so nothing changes
PeriodicMotion evaluate_gait(Floats motion_parameters, uint surfel, float actor_phase) {
    if (is_null(motion_parameters) || actor_phase < 0.0)
        return PeriodicMotion(0.0, vec3(0.0), 0.0, 1.0, 0.0, 1.0);
    uint i = 5u * surfel;
    float off = actor_phase - motion_parameters.at[i];
    // Reduces the phase difference to at most half a cycle, where sine and cosine are
    // most accurate.
    off = kTwoPi * (off - round(off));
    // `less` is cos(off) - 1 = -2 sin^2(off / 2). The second form has a smaller rounding
    // error, which matters because a large sharpness multiplies the error.
    float sharpness = motion_parameters.at[i + 1u], half_sine = sin(0.5 * off),
          less = -2.0 * half_sine * half_sine;
    return PeriodicMotion(
        sharpness,
        vec3(motion_parameters.at[i + 2u], motion_parameters.at[i + 3u], motion_parameters.at[i + 4u]),
        sin(off), cos(off), less, exp(sharpness * sharpness * less));
}

/// Computes the gradient of a surfel's five gait parameters (walking motion).
/// @param d_mean gradient of the moved mean position
/// @param d_presence gradient of the factor on the opacity
void gait_vjp(PeriodicMotion motion, vec3 d_mean, float d_presence, out float d_parameters[5]) {
    d_parameters[0] =
        -kTwoPi * (motion.cosine * dot(motion.swing, d_mean) -
                   motion.sharpness * motion.sharpness * motion.sine * motion.presence * d_presence);
    d_parameters[1] = 2.0 * motion.sharpness * motion.less * motion.presence * d_presence;
    for (uint k = 0u; k < 3u; ++k) d_parameters[2u + k] = motion.sine * d_mean[k];
}
#endif
