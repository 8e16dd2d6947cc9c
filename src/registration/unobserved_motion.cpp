// SPDX-License-Identifier: Apache-2.0
#include "registration/unobserved_motion.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace relidar {
namespace {

// Stiffness against an unobserved motion, in the unit in which the noise is 1. The false
// information is below min_information(), so it moves a pose by at most 0.1 %.
constexpr double kHoldStiffness = 1e4;

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
    while (n < 6 && solver.eigenvalues()[n] < min_information) ++n;
    // The coordinates A of the motions V fulfil A V = 1. A twist x minus V A x is the
    // smallest one that differs from x only by unobserved motions.
    Vector6 metric;
    metric << 1.0, 1.0, 1.0, kArm_m * kArm_m, kArm_m * kArm_m, kArm_m * kArm_m;
    const Eigen::Matrix<double, 6, Eigen::Dynamic> directions = solver.eigenvectors().leftCols(n);
    const Eigen::MatrixXd weighted = directions.transpose() * metric.asDiagonal();
    const Eigen::MatrixXd coordinates = (weighted * directions).llt().solve(weighted);
    std::vector<UnobservedMotion> motions;
    for (Eigen::Index i = 0; i < n; ++i)
        motions.push_back({to_twist(directions.col(i)), to_twist(coordinates.row(i).transpose())});
    return motions;
}

Matrix6 hold_stiffness(const std::vector<UnobservedMotion>& motions) {
    Matrix6 stiffness = Matrix6::Zero();
    for (const UnobservedMotion& motion : motions) {
        const Vector6 coordinate = to_vector(motion.coordinate);
        stiffness += kHoldStiffness * coordinate * coordinate.transpose();
    }
    return stiffness;
}

Matrix6 observed_projection(const std::vector<UnobservedMotion>& motions) {
    Matrix6 projection = Matrix6::Identity();
    for (const UnobservedMotion& motion : motions)
        projection -= to_vector(motion.direction) * to_vector(motion.coordinate).transpose();
    return projection;
}

Twist remove_unobserved(const Twist& twist, const std::vector<UnobservedMotion>& unobserved) {
    return to_twist(observed_projection(unobserved) * to_vector(twist));
}

}  // namespace relidar
