// SPDX-License-Identifier: Apache-2.0
// Rotation by a rotation vector. Uses series instead of sin() and cos(), because Vulkan
// allows them an error of 2^-11, which is 4 cm at 80 m.
#ifndef RELIDAR_INCLUDED_BASE_ROTATION_GLSL
#define RELIDAR_INCLUDED_BASE_ROTATION_GLSL

/// Returns sin(x) / x for a given x^2, with an error of at most 3e-7 for |x| <= pi.
float sine_over(float x2) {
    // clang-format off
    return 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0 * (1.0 - x2 / 72.0 *
           (1.0 - x2 / 110.0 * (1.0 - x2 / 156.0 * (1.0 - x2 / 210.0))))));
    // clang-format on
}

/// Returns exp([w]x) p, for rotations of up to a full turn.
vec3 turned(vec3 w, vec3 p) {
    float half2 = 0.25 * dot(w, w), quarter = sine_over(0.25 * half2);
    // sin(h) / h and cos(h) of half the angle h.
    float sine = sine_over(half2), cosine = 1.0 - 0.5 * half2 * quarter * quarter;
    vec3 q = cross(w, p);
    return p + sine * (cosine * q + 0.5 * sine * cross(w, q));
}
#endif
