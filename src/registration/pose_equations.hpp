// SPDX-License-Identifier: Apache-2.0
// Builds the Gauss-Newton equations for all poses of a track. The unknowns of planes are
// eliminated. A point p at fraction s between poses l and l + 1 moves by
//   dp = sum over k of a_k (v_k + w_k x (p - o)),  a = (1 - s, s),  o: vehicle position.
// Its residual n . (p - point) - b . (offset, tilts) has the row a_k j, j = (n, (p - o) x
// n). C couples a plane's three unknowns with the poses, B is their matrix, h their
// gradient:
//   H = sum w J J^T - C B^-1 C^T,  g = sum w r J - C B^-1 h   (Schur complement).
// H is positive definite if B uses the same weights w.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

#include <relidar/base/math.hpp>

#include "base/parallel.hpp"
#include "registration/plane_cells.hpp"
#include "registration/unobserved_motion.hpp"

namespace relidar {

/// Returns the six values of a pose in a vector of all poses.
template <class Vector>
auto block_of(Vector& vector, std::size_t pose_index) {
    return vector.template segment<6>(6 * Eigen::Index(pose_index));
}

/// Distance of a point from a plane, its weight, and its derivatives by a pose.
struct PlaneResidual {
    double residual_m, weight;
    Vector6 j;
    /// standard deviation of j: one column for each of the two tilts of the normal
    Eigen::Matrix<double, 6, 2> j_error;
    bool is_on_plane() const { return weight > 0.25; }
};
/// Returns the weight of a prior with standard deviation `sigma` (metres or radians), in
/// the unit in which a point of a plane has the weight 1. Points deviate by about 5 cm.
inline double point_weight(double sigma) {
    constexpr double kPointSigma_m = 0.05;
    return (kPointSigma_m / sigma) * (kPointSigma_m / sigma);
}
/// Returns the distance of a point from a plane, with its robust weight and its
/// derivatives by the twist of the vehicle pose (translation, rotation).
/// @param scale_m distance at which the weight is 1/4
PlaneResidual make_residual(const WorldPointWithOrigin& point, const LocalPlane& plane, double scale_m);

/// Gauss-Newton equations for one pose, while planes and other poses are fixed. Also
/// counts the points that lie on planes.
class SinglePoseEquations {
public:
    /// Adds the distance of a point from its plane.
    /// @param pose_motion_fraction  motion of the point / motion of the pose; below 1 if
    /// the point's position is interpolated between this pose and another pose
    void add_residual(const PlaneResidual& plane_residual, double pose_motion_fraction = 1.0);
    SinglePoseEquations& operator+=(const SinglePoseEquations& other);
    bool empty() const { return !(stiffness_.trace() > 0.0); }
    std::size_t count_on_planes() const { return n_on_planes_; }
    std::vector<UnobservedMotion> find_unobserved(double min_information) const {
        return relidar::find_unobserved(stiffness_, noise_, min_information);
    }
    /// Moves a pose by one Gauss-Newton step, unless the equations are empty.
    /// @param start  pose to which a weak prior pulls (kStartSigma_m, kStartSigma_rad)
    /// @param unobserved  motions in which the pose stays at `start`
    /// @return the distance in metres by which points ten metres away move
    double move_pose(Pose& pose, const Pose& start, const std::vector<UnobservedMotion>& unobserved) const;

private:
    Matrix6 stiffness_ = Matrix6::Zero();
    /// expected part of stiffness_ that comes from errors of the normals
    Matrix6 noise_ = Matrix6::Zero();
    Vector6 gradient_ = Vector6::Zero();
    std::size_t n_on_planes_ = 0;
};

/// Sums the equations of `n_points` points in parallel. The result does not depend on the
/// number of threads.
/// @param add_point  function (equations, index) that adds a point
template <class AddPoint>
SinglePoseEquations sum_point_equations(std::size_t n_points, const AddPoint& add_point) {
    constexpr std::size_t kPointsOfPart = 512;
    return parallel_sum(n_points, kPointsOfPart, [&](std::size_t begin, std::size_t end) {
        SinglePoseEquations part;
        for (std::size_t i = begin; i < end; ++i) add_point(part, i);
        return part;
    });
}

/// Returns the 6x6 matrix that converts the twist (v, w) of a rigid body to another
/// reference point. The result is (v + w x `offset_m`, w).
/// @param offset_m  second point minus first point
Matrix6 twist_transfer(const glm::dvec3& offset_m);

/// Normal equations for all poses, summed over the cells of a grid. Partial sums are
/// added in the order of the cells, so that threads do not change the result.
class PoseEquations {
public:
    explicit PoseEquations(std::size_t n_poses);

    /// Adds the distances of the points of a grid cell from its plane. A Schur complement
    /// eliminates the changes of the plane (offset and two tilts).
    void add_cell(const std::vector<SubsampledPoint>& points,
                  const std::vector<WorldPointWithOrigin>& world_points,
                  std::span<const std::uint32_t> point_indices, const LocalPlane& plane, double scale_m);
    void add_equations(PoseEquations&& other);
    /// Returns for each pose the motions that its points do not show if all other poses
    /// stay fixed. Call before priors are added.
    std::vector<std::vector<UnobservedMotion>> find_unobserved(double min_information) const;
    void add_zero_prior(std::size_t pose, const Vector6& weights, const Vector6& correction);
    /// Adds a term that pulls the motion from a pose to the next pose towards a given
    /// motion.
    /// @param weights  for the six values of a twist of the next pose
    /// @param offset_m  position of the next pose minus position of the pose
    /// @param difference  twist from the next pose according to the given motion to the
    /// actual next pose
    void add_motion_prior(std::size_t pose, const Matrix6& weights, const glm::dvec3& offset_m,
                          const Vector6& difference);
    /// Solves for the step of all poses, [n_poses,6], by conjugate gradients. The
    /// preconditioner consists of the diagonal blocks and a direct solution for rigid
    /// motions of groups of eight poses, so that long logs need no more iterations.
    Eigen::VectorXd solve_steps(const PoseTrack& track) const;

    std::size_t n_planes() const { return plane_end_.size(); }
    /// Returns how many points of the sweep of a pose lie on planes.
    std::size_t count_on_planes(std::size_t pose) const { return n_on_planes_[pose]; }
    double weight() const { return weight_; }  ///< sum of the weights of all points on planes
    double rms_residual_m() const { return weight_ > 0.0 ? std::sqrt(cost_ / weight_) : 0.0; }

private:
    /// Coupling c = C L^-T of a plane with one pose. C: 6x3 block of the normal matrix.
    /// L: Cholesky factor of the plane's 3x3 block. Eliminating the plane subtracts c_i
    /// c_j^T from block (i, j) of any two poses.
    struct PlanePoseCoupling {
        std::uint32_t pose;
        Eigen::Matrix<float, 6, 3> c;
    };
    /// [poses] blocks (k, k) and (k, k + 1) of the sum of w J^T J; other blocks are zero
    std::vector<Matrix6> diagonal_, off_diagonal_;
    /// [poses] expected part of diagonal_ that comes from errors of the normals
    std::vector<Matrix6> noise_;
    std::vector<std::size_t> n_on_planes_;  ///< [poses]
    Eigen::VectorXd gradient_;
    std::vector<PlanePoseCoupling> couplings_;  ///< of all planes, plane by plane
    std::vector<std::size_t> plane_end_;        ///< [planes] end of each plane's couplings
    double cost_ = 0.0, weight_ = 0.0;

    std::span<const PlanePoseCoupling> couplings_of(std::size_t plane) const {
        const std::size_t begin = plane == 0 ? 0 : plane_end_[plane - 1];
        return std::span(couplings_).subspan(begin, plane_end_[plane] - begin);
    }
    /// Adds the distance of a point, which moves with its two poses, from a fixed plane.
    void add_point(const SubsampledPoint& point, const PlaneResidual& plane_residual);
    /// Returns H x without building H, which is dense because planes couple many poses.
    Eigen::VectorXd multiply(const Eigen::VectorXd& input_vector) const;
    friend class PoseGroupEquations;
};

}  // namespace relidar
