// SPDX-License-Identifier: Apache-2.0
// Gauss-Newton equations of all poses of a track, planes eliminated. A point at fraction
// s between poses l and l + 1 moves by
//   dp = sum over k of a_k (v_k + w_k x (p - o)),  a = (1 - s, s),  o where the vehicle was,
// so its residual n . (p - point) - b . (offset, tilts) has the row a_k j, j = (n, (p -
// o) x n). The Schur complement of the three unknowns of a plane with couplings C,
// stiffness B and gradient h is
//   H = sum w J J^T - C B^-1 C^T,  g = sum w r J - C B^-1 h,
// positive where B is of the same weights w.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <relidar/base/math.hpp>

#include "log/registration/plane_cells.hpp"

namespace relidar {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// What a residual of a point is made of.
struct Row {
    double residual_m, weight;
    Vector6 j;
    bool is_on_plane() const { return weight > 0.25; }
};
Row row_of(const PlacedPoint& point, const Plane& plane, double scale_m);

/// Gauss-Newton equations of one pose while all else stays, and how many points lie on
/// their planes.
class RigidEquations {
public:
    /// @param share  of the pose's motion that the point takes part in
    void add(const Row& row, double share = 1.0);
    RigidEquations& operator+=(const RigidEquations& other);
    bool empty() const { return !(stiffness_.trace() > 0.0); }
    std::size_t n_on_planes() const { return n_on_planes_; }
    /// @param prior  share of the mean stiffness, of translations and of rotations, that
    /// pulls the pose back: decides what no point sees
    /// @param correction  what it is pulled back by
    Twist solve(double prior, const Twist& correction = {}) const;

private:
    Matrix6 stiffness_ = Matrix6::Zero();
    Vector6 gradient_ = Vector6::Zero();
    std::size_t n_on_planes_ = 0;
};

/// How far a step moves points that lie some ten metres away.
double length_m(const Twist& step);

/// What a twist about one place is about another, at d from it, that it carries along: v
/// + w x d, w.
Matrix6 carried_by(const glm::dvec3& d);

/// Sums over some cells. Added up in their order they are the same on any number of
/// threads.
class PoseEquations {
public:
    explicit PoseEquations(std::size_t n_poses);

    void add_point(const ThinPoint& point, const Row& row);
    /// Points of a cell on its plane.
    void add_cell(const std::vector<ThinPoint>& points, const std::vector<PlacedPoint>& placed,
                  std::span<const std::uint32_t> members, const Plane& plane, double scale_m);
    void add(PoseEquations&& other);
    /// Adds a prior that pulls the correction of one pose to zero.
    void add_pull(std::size_t pose, const Vector6& stiffness, const Vector6& correction);
    /// Adds a prior that pulls the corrections of `pose` and `pose + 1` to each other.
    /// @param difference  correction of `pose + 1` minus that of `pose`
    void add_link(std::size_t pose, const Vector6& stiffness, const Vector6& difference);

    /// Step of all poses, [n_poses,6], by conjugate gradients. Preconditioner: the
    /// diagonal blocks, and rigid motions of eight poses at a time, solved directly,
    /// without which the number of iterations would grow with the length of the log.
    /// @param track  of the poses @param prior added to the diagonal, as a share of its
    /// mean; pulls `correction` to zero
    Eigen::VectorXd solve(const PoseTrack& track, const Eigen::VectorXd& correction, double prior) const;

    std::size_t n_planes() const { return n_planes_; }
    double residual_m() const { return weight_ > 0.0 ? std::sqrt(cost_ / weight_) : 0.0; }

private:
    /// C L^-T of one plane and one pose, B = L L^T.
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
    /// Diagonal of what pulls a correction to zero, [6].
    Vector6 pull_of(double prior) const;
    friend class GroupMotions;
};

}  // namespace relidar
