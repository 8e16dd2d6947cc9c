// SPDX-License-Identifier: Apache-2.0
// Rigid poses and small motions, in double precision because a log may be kilometres from
// its origin. The name of a transform is read from right to left: `world_from_sensor *
// point_sensor` is a point in the world frame.
#pragma once

#include <array>

#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace relidar {

/// Rigid transform `a_from_b`: p_a = rotation * p_b + translation.
struct Pose {
    glm::dquat rotation{1.0, 0.0, 0.0, 0.0};  ///< Unit quaternion (w, x, y, z).
    glm::dvec3 translation{0.0};              ///< Translation, metres.

    /// Transforms a point from frame b to frame a.
    /// @param point [3] metres, frame b
    /// @return [3] metres, frame a
    glm::dvec3 operator*(const glm::dvec3& point) const { return rotation * point + translation; }

    /// Composes two transforms: a_from_b * b_from_c = a_from_c.
    Pose operator*(const Pose& other) const {
        return {glm::normalize(rotation * other.rotation), rotation * other.translation + translation};
    }
};

/// Returns the inverse transform: b_from_a for a_from_b.
inline Pose inverse(const Pose& pose) {
    const glm::dquat r = glm::conjugate(pose.rotation);
    return {r, -(r * pose.translation)};
}

/// Interpolates between two poses. Rotations use slerp and translations use linear
/// interpolation.
/// @param fraction 0 gives `first` and 1 gives `second`. Values outside [0, 1]
/// extrapolate at constant velocity.
inline Pose interpolate(const Pose& first, const Pose& second, double fraction) {
    return {glm::normalize(glm::slerp(first.rotation, second.rotation, fraction)),
            first.translation + fraction * (second.translation - first.translation)};
}

/// Returns the rotation R_z(yaw) R_y(pitch) R_x(roll), which applies roll first and yaw
/// last. Axes: x forward, y left, z up. Angles in radians.
inline glm::dquat make_rotation(double yaw_rad, double pitch_rad, double roll_rad) {
    return glm::angleAxis(yaw_rad, glm::dvec3(0, 0, 1)) * glm::angleAxis(pitch_rad, glm::dvec3(0, 1, 0)) *
           glm::angleAxis(roll_rad, glm::dvec3(1, 0, 0));
}

/// Small motion of a pose: a translation v (metres, world frame), then a rotation vector
/// w (radians, world axes, about the pose's origin). Also used for derivatives with
/// respect to v and w.
using Twist = std::array<double, 6>;

/// Returns the pose after a small motion (v, w). The rotation R becomes exp([w]x) R, and
/// the translation T becomes T + v.
inline Pose apply_twist(const Pose& pose, const Twist& twist) {
    const glm::dvec3 v(twist[0], twist[1], twist[2]), w(twist[3], twist[4], twist[5]);
    const double angle = glm::length(w);
    if (angle == 0.0) return {pose.rotation, pose.translation + v};
    return {glm::normalize(glm::angleAxis(angle, w / angle) * pose.rotation), pose.translation + v};
}

/// Returns the small motion that moves the pose `start` to the pose `end`. The rotation
/// angle is at most pi.
inline Twist compute_twist(const Pose& start, const Pose& end) {
    glm::dquat q = end.rotation * glm::conjugate(start.rotation);
    if (q.w < 0.0) q = -q;
    const glm::dvec3 sine(q.x, q.y, q.z), v = end.translation - start.translation;
    const double length = glm::length(sine);
    const glm::dvec3 w = length > 0.0 ? 2.0 * glm::atan(length, q.w) / length * sine : glm::dvec3(0.0);
    return {v.x, v.y, v.z, w.x, w.y, w.z};
}

/// Motion of an object during a sweep. The object moves with constant velocity and turn
/// rate within a time span. Before and after the span it is at rest. If all fields are
/// zero, the object does not move.
struct PoseMotion {
    glm::dvec3 velocity_mps{0.0};  ///< Velocity in the world frame, metres per second.
    /// Rotation vector per second, rad/s, in world axes. The object rotates about its
    /// origin.
    glm::dvec3 angular_velocity_radps{0.0};
    /// Middle of the time span, in seconds after the reference time of the sweep.
    double middle_s = 0.0;
    double half_span_s = 0.0;

    bool is_stationary() const {
        return !(half_span_s > 0.0) ||
               (velocity_mps == glm::dvec3(0.0) && angular_velocity_radps == glm::dvec3(0.0));
    }
    /// Returns the pose of the object at the time `time_offset_s`, in seconds after the
    /// reference time of the sweep.
    /// @param middle_pose pose of the object in the middle of the time span
    Pose pose_at(const Pose& middle_pose, double time_offset_s) const {
        const double since_s = glm::clamp(time_offset_s - middle_s, -half_span_s, half_span_s);
        const glm::dvec3 v = since_s * velocity_mps, w = since_s * angular_velocity_radps;
        return apply_twist(middle_pose, {v.x, v.y, v.z, w.x, w.y, w.z});
    }
};

/// Returns the 4x4 matrix of a pose (GLM, column-major).
inline glm::dmat4 to_matrix(const Pose& pose) {
    glm::dmat4 m = glm::mat4_cast(pose.rotation);
    m[3] = glm::dvec4(pose.translation, 1.0);
    return m;
}

constexpr double kPi = 3.14159265358979323846;

}  // namespace relidar
