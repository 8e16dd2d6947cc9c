// SPDX-License-Identifier: Apache-2.0
// Decides which motions of a pose the scans show. Along a tunnel, the planes of a map
// hold no information. But their fitted normals are slightly wrong, and so the points
// seem to determine the position. Equations: docs/method.md section 6.
#pragma once

#include <vector>

#include <Eigen/Core>

#include <relidar/registration/registration.hpp>

namespace relidar {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

inline Twist to_twist(const Vector6& x) { return {x[0], x[1], x[2], x[3], x[4], x[5]}; }
inline Vector6 to_vector(const Twist& twist) { return Eigen::Map<const Vector6>(twist.data()); }

/// Information from which a motion is observed, as a multiple of what errors of the
/// normals alone would give. With given poses, the information must be clear. Without
/// them, weak information is better than a guess.
inline double min_information(bool has_given_poses) { return has_given_poses ? 10.0 : 2.0; }

/// Returns the motions v with v^T H v < 2 min_information v^T N v. From min_information
/// on, they are hidden less and less, so that small changes of the points change little.
/// @param information  H, normal matrix of the points by the twist of the pose
/// @param noise  N, expected value of H if only errors of the normals contributed to it
std::vector<UnobservedMotion> find_unobserved(const Matrix6& information, const Matrix6& noise,
                                              double min_information);

/// Returns the weight matrix that prevents the given motions: the sum of stiffness a a^T
/// over their coordinates a.
Matrix6 hold_stiffness(const std::vector<UnobservedMotion>& motions);

/// Returns the matrix of remove_unobserved().
Matrix6 observed_projection(const std::vector<UnobservedMotion>& motions);

}  // namespace relidar
