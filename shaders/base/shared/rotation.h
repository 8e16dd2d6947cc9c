// SPDX-License-Identifier: Apache-2.0
// Rotates points by a rotation vector. Host and device compute bit-identical results.
//
// Sine and cosine are computed as series, because Vulkan allows errors of 2^-11 for sin()
// and cos(). Such an error moves a point by 4 cm at 80 m. The series use only additions,
// subtractions and multiplications, because Vulkan allows different rounding for all
// other operations.
#ifndef RELIDAR_INCLUDED_BASE_SHARED_ROTATION_H
#define RELIDAR_INCLUDED_BASE_SHARED_ROTATION_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

RELIDAR_FUNCTION vec3 exact_cross(vec3 a, vec3 b) {
    RELIDAR_EXACT vec3 c = vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    return c;
}

/// Returns sin(x) / x, computed as a power series in x^2. The error is at most 3e-7 for
/// |x| <= pi.
RELIDAR_FUNCTION float sinc_of_square(float x_squared) {
    RELIDAR_EXACT float sum = 1.0f - x_squared * 0.00476190476f;
    sum = 1.0f - x_squared * 0.00641025641f * sum;
    sum = 1.0f - x_squared * 0.00909090909f * sum;
    sum = 1.0f - x_squared * 0.0138888889f * sum;
    sum = 1.0f - x_squared * 0.0238095238f * sum;
    sum = 1.0f - x_squared * 0.05f * sum;
    sum = 1.0f - x_squared * 0.166666667f * sum;
    return sum;
}

/// Returns the point `point` rotated by the rotation vector `rotation`: exp([rotation]x)
/// point. rotation is the axis times the angle, at most one full turn.
RELIDAR_FUNCTION vec3 rotate_point(vec3 rotation, vec3 point) {
    RELIDAR_EXACT float half2 =
        0.25f * (rotation.x * rotation.x + rotation.y * rotation.y + rotation.z * rotation.z);
    RELIDAR_EXACT float quarter2 = 0.25f * half2;
    // series for 1/2 and 1/4 of the rotation angle
    float sine = sinc_of_square(half2), quarter = sinc_of_square(quarter2);
    RELIDAR_EXACT float cosine = 1.0f - 0.5f * half2 * quarter * quarter;
    vec3 once = exact_cross(rotation, point), twice = exact_cross(rotation, once);
    RELIDAR_EXACT vec3 result = point + sine * (cosine * once + 0.5f * sine * twice);
    return result;
}

RELIDAR_SHARED_END
#endif
