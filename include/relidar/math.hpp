// SPDX-License-Identifier: Apache-2.0
// Rigid poses and the few host-side vector types every stage shares. Double precision: a log may lie kilometres from its
// origin. Transforms read right to left: `world_from_sensor * point_sensor`.
#pragma once

#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace relidar {

/// Rigid transform `a_from_b`: p_a = rotation * p_b + translation.
struct Pose {
    glm::dquat rotation{1.0, 0.0, 0.0, 0.0};  ///< unit quaternion (w, x, y, z)
    glm::dvec3 translation{0.0};              ///< metres

    /// Applies the transform to a point. @param point [3] metres, frame b @return [3] metres, frame a
    glm::dvec3 operator*(const glm::dvec3& point) const { return rotation * point + translation; }

    /// Composition: (a_from_b * b_from_c) = a_from_c.
    Pose operator*(const Pose& other) const {
        return {glm::normalize(rotation * other.rotation), rotation * other.translation + translation};
    }
};

/// Inverse transform: a_from_b becomes b_from_a.
inline Pose inverse(const Pose& pose) {
    const glm::dquat r = glm::conjugate(pose.rotation);
    return {r, -(r * pose.translation)};
}

/// Pose between two poses: slerp of the rotation, lerp of the translation.
/// @param s  [0, 1] gives a..b; values outside extrapolate at constant velocity.
inline Pose interpolate(const Pose& a, const Pose& b, double s) {
    return {glm::normalize(glm::slerp(a.rotation, b.rotation, s)), a.translation + s * (b.translation - a.translation)};
}

/// 4x4 matrix of a pose (GLM, column-major).
inline glm::dmat4 to_matrix(const Pose& pose) {
    glm::dmat4 m = glm::mat4_cast(pose.rotation);
    m[3] = glm::dvec4(pose.translation, 1.0);
    return m;
}

constexpr double kPi = 3.14159265358979323846;

}  // namespace relidar
