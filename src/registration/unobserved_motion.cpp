// SPDX-License-Identifier: Apache-2.0
#include "registration/unobserved_motion.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace relidar {
namespace {

// Stiffness against an unobserved motion, as a multiple of min_information().
constexpr double kHold = 1000.0;
// The stiffness falls with this power of the information above min_information(). So half
// of a motion is hidden at 1.5 times this information, and less than 1 % at twice.
constexpr double kHoldFall = 16.0;
// A rotation by 1 radian counts as much as a motion of this length.
constexpr double kArm_m = 5.0;

}  // namespace

std::vector<UnobservedMotion> find_unobserved(const Matrix6& information, const Matrix6& noise,
                                              double min_information) {
    // A little more noise keeps the matrix positive definite if there are few points.
    Matrix6 more_noise = noise;
    more_noise.diagonal() *= 1.0 + 1e-6;
    more_noise.diagonal().array() += 1e-9;
    const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6> solver(information, more_noise);
    Eigen::Index n = 0;
    while (n < 6 && solver.eigenvalues()[n] < 2.0 * min_information) ++n;
    // The coordinates A of the motions V fulfil A V = 1. A twist x minus V A x is the
    // smallest one that differs from x only by unobserved motions.
    Vector6 metric;
    metric << 1.0, 1.0, 1.0, kArm_m * kArm_m, kArm_m * kArm_m, kArm_m * kArm_m;
    const Eigen::Matrix<double, 6, Eigen::Dynamic> directions = solver.eigenvectors().leftCols(n);
    const Eigen::MatrixXd weighted = directions.transpose() * metric.asDiagonal();
    const Eigen::MatrixXd coordinates = (weighted * directions).llt().solve(weighted);
    std::vector<UnobservedMotion> motions;
    for (Eigen::Index i = 0; i < n; ++i) {
        const double shown = std::max(solver.eigenvalues()[i], 0.0),
                     stiffness = kHold * min_information *
                                 std::pow(min_information / std::max(shown, min_information), kHoldFall);
        motions.push_back({to_twist(directions.col(i)), to_twist(coordinates.row(i).transpose()), stiffness,
                           stiffness / (stiffness + shown)});
    }
    return motions;
}

Matrix6 hold_stiffness(const std::vector<UnobservedMotion>& motions) {
    Matrix6 stiffness = Matrix6::Zero();
    for (const UnobservedMotion& motion : motions) {
        const Vector6 coordinate = to_vector(motion.coordinate);
        stiffness += motion.stiffness * coordinate * coordinate.transpose();
    }
    return stiffness;
}

Matrix6 observed_projection(const std::vector<UnobservedMotion>& motions) {
    Matrix6 projection = Matrix6::Identity();
    for (const UnobservedMotion& motion : motions)
        projection -= motion.hidden * to_vector(motion.direction) * to_vector(motion.coordinate).transpose();
    return projection;
}

Twist remove_unobserved(const Twist& twist, const std::vector<UnobservedMotion>& unobserved) {
    return to_twist(observed_projection(unobserved) * to_vector(twist));
}

}  // namespace relidar
