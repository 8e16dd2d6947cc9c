// SPDX-License-Identifier: Apache-2.0
// Gauss-Newton equations of all poses of a track, with the planes eliminated. A point at
// fraction s between poses l and l + 1 moves by
//   dp = sum over k of a_k (v_k + w_k x (p - o)),  a = (1 - s, s),  o the position of the vehicle.
// Its residual n . (p - point) - b . (offset, tilts) has the row a_k j with j = (n, (p -
// o) x n). The Schur complement of a plane's three unknowns, with couplings C, stiffness
// B and gradient h, is
//   H = sum w J J^T - C B^-1 C^T,  g = sum w r J - C B^-1 h.
// H is positive if B uses the same weights w.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <relidar/base/math.hpp>

#include "log/registration/plane_cells.hpp"

namespace relidar {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// Residual of a point, its weight and its derivative.
struct Row {
    double residual_m, weight;
    Vector6 j;
    bool is_on_plane() const { return weight > 0.25; }
};
Row row_of(const PlacedPoint& point, const Plane& plane, double scale_m);

/// Gauss-Newton equations of a single pose while all other poses are fixed. Also counts
/// the points that lie on their planes.
class RigidEquations {
public:
    /// Adds the residual of a point.
    /// @param share  share of the pose's motion that applies to the point
    void add(const Row& row, double share = 1.0);
    RigidEquations& operator+=(const RigidEquations& other);
    bool empty() const { return !(stiffness_.trace() > 0.0); }
    std::size_t n_on_planes() const { return n_on_planes_; }
    /// Solves for the step of the pose.
    /// @param prior  stiffness that pulls the pose back, relative to the mean stiffness
    /// of translations and of rotations. It determines the directions that no point
    /// constrains.
    /// @param correction  current correction, which the prior pulls to zero
    Twist solve(double prior, const Twist& correction = {}) const;

private:
    Matrix6 stiffness_ = Matrix6::Zero();
    Vector6 gradient_ = Vector6::Zero();
    std::size_t n_on_planes_ = 0;
};

/// Returns the displacement that a step causes for points about ten metres away.
double length_m(const Twist& step);

/// Returns the matrix that converts a twist about one point to the twist of the same
/// rigid motion about a point at offset d: v + w x d, w.
Matrix6 carried_by(const glm::dvec3& d);

/// Sums of the equations over some cells. They are added in order, so that the result
/// does not depend on the number of threads.
class PoseEquations {
public:
    explicit PoseEquations(std::size_t n_poses);

    void add_point(const ThinPoint& point, const Row& row);
    /// Adds the points of a cell and its plane.
    void add_cell(const std::vector<ThinPoint>& points, const std::vector<PlacedPoint>& placed,
                  std::span<const std::uint32_t> members, const Plane& plane, double scale_m);
    void add(PoseEquations&& other);

    /// Computes the step of all poses, [n_poses,6], by conjugate gradients. The
    /// preconditioner combines the diagonal blocks with a direct solution for rigid
    /// motions of groups of eight poses. Without these groups the number of iterations
    /// would grow with the length of the log.
    /// @param track  current poses
    /// @param prior  added to the diagonal, relative to its mean; pulls `correction` to
    /// zero
    Eigen::VectorXd solve(const PoseTrack& track, const Eigen::VectorXd& correction, double prior) const;

    std::size_t n_planes() const { return n_planes_; }
    double residual_m() const { return weight_ > 0.0 ? std::sqrt(cost_ / weight_) : 0.0; }

private:
    /// C L^-T of one plane and one pose, where B = L L^T.
    struct Coupling {
        std::uint32_t pose;
        Eigen::Matrix<float, 6, 3> c;
    };
    std::vector<Matrix6> diagonal_, next_;  ///< blocks (k, k) and (k, k + 1) of sum w J J^T
    Eigen::VectorXd gradient_;
    std::vector<Coupling> couplings_;
    std::vector<std::size_t> plane_end_;  ///< [planes] into couplings_
    std::size_t n_planes_ = 0;
    double cost_ = 0.0, weight_ = 0.0;

    Eigen::VectorXd times(const Eigen::VectorXd& x) const;
    /// Returns the diagonal [6] of the prior, which pulls a correction to zero.
    Vector6 pull_of(double prior) const;
    friend class GroupMotions;
};

}  // namespace relidar
