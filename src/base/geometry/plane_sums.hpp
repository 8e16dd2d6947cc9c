// SPDX-License-Identifier: Apache-2.0
// Fits a plane to points that are added one by one. d is a point relative to an origin.
// The normal of the plane is the axis of least variance.
//   mean = sum d / n,   covariance = sum d d^T / n - mean mean^T
#pragma once

#include <Eigen/Eigenvalues>
#include <glm/glm.hpp>

namespace relidar {

struct PlaneFit {
    glm::dvec3 mean{0.0};
    glm::dvec3 variance{0.0};  ///< Variances along the axes, ascending.
    /// Unit length. The first axis is the normal of the plane.
    glm::dvec3 axes[3];
};

struct PointMomentSums {
    double n = 0.0;
    /// Sums over all points: coordinates, their squares, and products y z, x z and x y.
    glm::dvec3 sum{0.0}, squares{0.0}, products{0.0};

    /// @param point_relative_to_origin point minus an origin near all points, because
    /// squares of large coordinates would lose precision
    void add_point(const glm::dvec3& point_relative_to_origin) {
        n += 1.0;
        sum += point_relative_to_origin;
        squares += point_relative_to_origin * point_relative_to_origin;
        products += glm::dvec3(point_relative_to_origin.y * point_relative_to_origin.z,
                               point_relative_to_origin.x * point_relative_to_origin.z,
                               point_relative_to_origin.x * point_relative_to_origin.y);
    }

    /// Returns the least-squares plane of the added points, relative to the same origin.
    /// Requires at least one point.
    PlaneFit fit_plane() const {
        const glm::dvec3 mean = sum / n, s = squares / n - mean * mean,
                         p = products / n - glm::dvec3(mean.y * mean.z, mean.x * mean.z, mean.x * mean.y);
        Eigen::Matrix3d covariance;
        covariance << s.x, p.z, p.y, p.z, s.y, p.x, p.y, p.x, s.z;
        const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
        PlaneFit fit{mean, {solver.eigenvalues()[0], solver.eigenvalues()[1], solver.eigenvalues()[2]}, {}};
        for (int i = 0; i < 3; ++i)
            fit.axes[i] = {solver.eigenvectors()(0, i), solver.eigenvectors()(1, i),
                           solver.eigenvectors()(2, i)};
        return fit;
    }
};

}  // namespace relidar
