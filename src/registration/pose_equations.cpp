// SPDX-License-Identifier: Apache-2.0
#include "registration/pose_equations.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <span>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/SparseCholesky>

#include "base/parallel.hpp"

namespace relidar {
namespace {

// Usually 20 to 30 are enough, even for long logs.
constexpr int kMaxIterations = 100;
// Sums over planes run in parallel: at most kMaxPlaneParts sums over at least
// kMinPlanesPerPart planes.
constexpr std::size_t kMaxPlaneParts = 64, kMinPlanesPerPart = 256;
// The conjugate-gradient solver stops if the residual norm has fallen to this fraction of
// its initial value. Later Gauss-Newton steps correct the remaining error.
constexpr double kSolverTolerance = 1e-4;

Eigen::Vector3d to_eigen(const glm::dvec3& vector) { return {vector.x, vector.y, vector.z}; }

/// Returns the two poses between which a point was measured and their weights.
std::array<std::pair<std::size_t, double>, 2> poses_of_point(const SubsampledPoint& point) {
    return {{{point.left, 1.0 - double(point.s)}, {point.left + 1, double(point.s)}}};
}

/// Returns the derivatives of a point's distance by the plane's three unknowns, except
/// for their sign: offset along the normal, slopes along u and v.
Eigen::Vector3d plane_jacobian(const WorldPointWithOrigin& point, const LocalPlane& plane) {
    const glm::dvec3 d = point.point_m - plane.point_m;
    return {1.0, glm::dot(plane.u, d), glm::dot(plane.v, d)};
}

}  // namespace

PlaneResidual make_residual(const WorldPointWithOrigin& point, const LocalPlane& plane, double scale_m) {
    PlaneResidual row;
    row.residual_m = glm::dot(plane.normal, point.point_m - plane.point_m);
    row.weight = robust_weight(row.residual_m, scale_m);
    row.j << to_eigen(plane.normal), to_eigen(glm::cross(point.point_m - point.vehicle_m, plane.normal));
    return row;
}

void SinglePoseEquations::add_residual(const PlaneResidual& plane_residual, double pose_motion_fraction) {
    stiffness_ += plane_residual.weight * pose_motion_fraction * pose_motion_fraction * plane_residual.j *
                  plane_residual.j.transpose();
    gradient_ += plane_residual.weight * pose_motion_fraction * plane_residual.residual_m * plane_residual.j;
    n_on_planes_ += plane_residual.is_on_plane();
}

SinglePoseEquations& SinglePoseEquations::operator+=(const SinglePoseEquations& other) {
    stiffness_ += other.stiffness_;
    gradient_ += other.gradient_;
    n_on_planes_ += other.n_on_planes_;
    return *this;
}

double SinglePoseEquations::move_pose(Pose& pose, double prior_weight,
                                      const Twist& current_correction) const {
    if (empty()) return 0.0;
    // Solves (H + P) x = -(g + P c). H: stiffness, g: gradient, P: diagonal prior, c:
    // current correction. Metres and radians differ in size, so the prior has one weight
    // for each.
    Matrix6 stiffness = stiffness_;
    Vector6 gradient = gradient_;
    const double prior_m = prior_weight * stiffness_.diagonal().head<3>().mean(),
                 prior_rad = prior_weight * stiffness_.diagonal().tail<3>().mean();
    for (int i = 0; i < 6; ++i) {
        const double prior = i < 3 ? prior_m : prior_rad;
        stiffness(i, i) += prior;
        gradient[i] += prior * current_correction[std::size_t(i)];
    }
    const Vector6 step = -stiffness.llt().solve(gradient);
    pose = apply_twist(pose, to_twist(step));
    constexpr double kArm_m = 10.0;  // distance of the points whose motion is returned
    return glm::length(glm::dvec3(step[0], step[1], step[2])) +
           kArm_m * glm::length(glm::dvec3(step[3], step[4], step[5]));
}

Matrix6 twist_transfer(const glm::dvec3& offset_m) {
    Matrix6 m = Matrix6::Identity();
    m.topRightCorner<3, 3>() << 0.0, offset_m.z, -offset_m.y, -offset_m.z, 0.0, offset_m.x, offset_m.y,
        -offset_m.x, 0.0;
    return m;
}

/// Equations of `n_poses` poses without any points.
PoseEquations::PoseEquations(std::size_t n_poses)
    : diagonal_(n_poses, Matrix6::Zero()),
      next_(n_poses, Matrix6::Zero()),
      gradient_(Eigen::VectorXd::Zero(6 * Eigen::Index(n_poses))) {}

void PoseEquations::add_point(const SubsampledPoint& point, const PlaneResidual& plane_residual) {
    // The two poses with their interpolation weights. The residual's derivative by the
    // twist of a pose is its weight times j.
    const auto [before, after] = poses_of_point(point);
    const Matrix6 square = plane_residual.weight * plane_residual.j * plane_residual.j.transpose();
    for (const auto& [pose, share] : {before, after}) {
        if (share == 0.0) continue;
        block_of(gradient_, pose) +=
            plane_residual.weight * plane_residual.residual_m * share * plane_residual.j;
        diagonal_[pose] += share * share * square;
    }
    // The block below the diagonal is the transpose, so it is not stored.
    next_[before.first] += before.second * after.second * square;
    cost_ += plane_residual.weight * plane_residual.residual_m * plane_residual.residual_m;
    weight_ += plane_residual.weight;
}

void PoseEquations::add_cell(const std::vector<SubsampledPoint>& points,
                             const std::vector<WorldPointWithOrigin>& world_points,
                             std::span<const std::uint32_t> point_indices, const LocalPlane& plane,
                             double scale_m) {
    const std::size_t begin = couplings_.size();
    // Searches backwards, because points are almost sorted by pose.
    const auto coupling = [&](std::size_t pose) -> PlanePoseCoupling& {
        for (std::size_t k = couplings_.size(); k-- > begin;)
            if (couplings_[k].pose == pose) return couplings_[k];
        return couplings_.emplace_back(
            PlanePoseCoupling{static_cast<std::uint32_t>(pose), Eigen::Matrix<float, 6, 3>::Zero()});
    };
    // Normal matrix and right-hand side of the plane's three unknowns. With other point
    // weights than in the pose equations, the Schur complement is not positive definite.
    Eigen::Matrix3d stiffness = Eigen::Matrix3d::Zero();
    Eigen::Vector3d pull = Eigen::Vector3d::Zero();
    for (const std::uint32_t i : point_indices) {
        const PlaneResidual row = make_residual(world_points[i], plane, scale_m);
        const Eigen::Vector3d b = plane_jacobian(world_points[i], plane);
        stiffness += row.weight * b * b.transpose();
        pull += row.weight * row.residual_m * b;
    }
    // A coupling is c = C L^-T with the Cholesky factor L of this matrix. So the points
    // are visited a second time: each adds its share of C, multiplied by L^-T.
    const Eigen::LLT<Eigen::Matrix3d> root(stiffness);
    if (root.info() != Eigen::Success) return;
    const auto whitened = [&](const Eigen::Vector3d& b) -> Eigen::Vector3d {
        return root.matrixL().solve(b);
    };
    for (const std::uint32_t i : point_indices) {
        const PlaneResidual row = make_residual(world_points[i], plane, scale_m);
        add_point(points[i], row);
        const Eigen::Vector3d b = whitened(plane_jacobian(world_points[i], plane));
        for (const auto& [pose, share] : poses_of_point(points[i]))
            if (share != 0.0) coupling(pose).c += (share * row.weight * row.j * b.transpose()).cast<float>();
    }
    for (std::size_t k = begin; k < couplings_.size(); ++k)
        block_of(gradient_, couplings_[k].pose) -= couplings_[k].c.cast<double>() * whitened(pull);
    plane_end_.push_back(couplings_.size());
    ++n_planes_;
}

/// Adds the sums over other cells.
void PoseEquations::add_equations(PoseEquations&& other) {
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        diagonal_[k] += other.diagonal_[k];
        next_[k] += other.next_[k];
    }
    gradient_ += other.gradient_;
    // Ends of planes are positions in couplings_, so they shift by its current size.
    for (const std::size_t end : other.plane_end_) plane_end_.push_back(couplings_.size() + end);
    couplings_.insert(couplings_.end(), other.couplings_.begin(), other.couplings_.end());
    n_planes_ += other.n_planes_;
    cost_ += other.cost_;
    weight_ += other.weight_;
    other = PoseEquations(0);  // frees the memory of `other`
}

void PoseEquations::add_zero_prior(std::size_t pose, const Vector6& weights, const Vector6& correction) {
    diagonal_[pose].diagonal() += weights;
    block_of(gradient_, pose) += weights.cwiseProduct(correction);
}

void PoseEquations::add_smooth_prior(std::size_t pose, const Vector6& weights, const Vector6& difference) {
    diagonal_[pose].diagonal() += weights;
    diagonal_[pose + 1].diagonal() += weights;
    next_[pose].diagonal() -= weights;
    block_of(gradient_, pose) -= weights.cwiseProduct(difference);
    block_of(gradient_, pose + 1) += weights.cwiseProduct(difference);
}

Eigen::VectorXd PoseEquations::multiply(const Eigen::VectorXd& x) const {
    // H = T - sum over planes of c c^T. T: block tridiagonal (diagonal_, next_).
    // c: couplings of a plane, a block of 6 x 3 for each pose that sees it.
    Eigen::VectorXd y = Eigen::VectorXd::Zero(x.size());
    // T x: points connect only neighbouring poses.
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        block_of(y, k) += diagonal_[k] * block_of(x, k);
        if (k + 1 == diagonal_.size()) break;
        block_of(y, k) += next_[k] * block_of(x, k + 1);
        block_of(y, k + 1) += next_[k].transpose() * block_of(x, k);
    }
    if (n_planes_ == 0) return y;
    // c c^T x: planes connect all poses that see them.
    y -= parallel_sum(
        n_planes_, std::max(kMinPlanesPerPart, n_planes_ / kMaxPlaneParts + 1),
        [&](std::size_t first, std::size_t last) {
            Eigen::VectorXd part = Eigen::VectorXd::Zero(x.size());
            for (std::size_t plane = first; plane < last; ++plane) {
                const std::size_t begin = plane == 0 ? 0 : plane_end_[plane - 1], end = plane_end_[plane];
                Eigen::Vector3d c_times_x = Eigen::Vector3d::Zero();
                for (std::size_t k = begin; k < end; ++k)
                    c_times_x += couplings_[k].c.cast<double>().transpose() * block_of(x, couplings_[k].pose);
                for (std::size_t k = begin; k < end; ++k)
                    block_of(part, couplings_[k].pose) += couplings_[k].c.cast<double>() * c_times_x;
            }
            return part;
        });
    return y;
}

/// Equations for groups of eight consecutive poses that move like one rigid body, a part
/// of the solver's preconditioner.
class PoseGroupEquations {
public:
    /// Sums the equations of all poses to equations of their groups, and factorises them.
    /// @param pull diagonal of the prior of each pose
    PoseGroupEquations(const PoseEquations& equations, const PoseTrack& track, const Vector6& pull)
        : n_(equations.diagonal_.size()) {
        for (std::size_t k = 0; k < n_; ++k)
            carry_.push_back(twist_transfer(track.pose[k].translation -
                                            track.pose[k / kPosesPerGroup * kPosesPerGroup].translation));
        for (std::size_t k = 0; k < n_; ++k) {
            const std::size_t group = k / kPosesPerGroup, next_group = (k + 1) / kPosesPerGroup;
            find_block(group, group) +=
                carry_[k].transpose() * (equations.diagonal_[k] + Matrix6(pull.asDiagonal())) * carry_[k];
            if (k + 1 == n_) break;
            const Matrix6 pair_matrix = carry_[k].transpose() * equations.next_[k] * carry_[k + 1];
            find_block(group, next_group) += pair_matrix;
            find_block(next_group, group) += pair_matrix.transpose();
        }
        std::size_t begin = 0;
        for (const std::size_t end : equations.plane_end_) {
            add_couplings(std::span(equations.couplings_).subspan(begin, end - begin));
            begin = end;
        }
        factorise_matrix();
    }

    /// Solves for one rigid motion per group of poses, and adds it to each of its poses
    /// in `pose_steps`. `right_hand_side`: 6 values per pose
    void add_group_motions(const Eigen::VectorXd& right_hand_side, Eigen::VectorXd& pose_steps) const {
        if (solver_.info() != Eigen::Success) return;
        Eigen::VectorXd sums = Eigen::VectorXd::Zero(6 * Eigen::Index(n_groups()));
        for (std::size_t k = 0; k < n_; ++k)
            block_of(sums, k / kPosesPerGroup) += carry_[k].transpose() * block_of(right_hand_side, k);
        const Eigen::VectorXd motion = solver_.solve(sums);
        for (std::size_t k = 0; k < n_; ++k)
            block_of(pose_steps, k) += carry_[k] * block_of(motion, k / kPosesPerGroup);
    }

private:
    static constexpr std::size_t kPosesPerGroup = 8;

    const std::size_t n_;
    // [poses] converts the twist (6 values) of the group to the twist of one pose
    std::vector<Matrix6> carry_;
    std::map<std::pair<std::size_t, std::size_t>, Matrix6> blocks_;  // key: row, column
    Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> solver_;

    std::size_t n_groups() const { return (n_ + kPosesPerGroup - 1) / kPosesPerGroup; }
    Matrix6& find_block(std::size_t row, std::size_t column) {
        return blocks_.try_emplace({row, column}, Matrix6::Zero()).first->second;
    }

    /// Subtracts the Schur complement of one plane. First adds up the couplings of poses
    /// in the same group, because they move together.
    void add_couplings(std::span<const PoseEquations::PlanePoseCoupling> couplings) {
        std::vector<std::pair<std::size_t, Eigen::Matrix<double, 6, 3>>> groups;
        for (const PoseEquations::PlanePoseCoupling& coupling : couplings) {
            const std::size_t group = coupling.pose / kPosesPerGroup;
            auto group_entry =
                std::find_if(groups.begin(), groups.end(), [&](const auto& g) { return g.first == group; });
            if (group_entry == groups.end())
                group_entry = groups.insert(groups.end(), {group, Eigen::Matrix<double, 6, 3>::Zero()});
            group_entry->second += carry_[coupling.pose].transpose() * coupling.c.cast<double>();
        }
        for (const auto& [row, a] : groups)
            for (const auto& [column, b] : groups) find_block(row, column) -= a * b.transpose();
    }

    /// Builds the sparse matrix from its 6x6 blocks and computes its Cholesky factor.
    void factorise_matrix() {
        std::vector<Eigen::Triplet<double>> entries;
        for (const auto& [at, m] : blocks_)
            for (int r = 0; r < 6; ++r)
                for (int c = 0; c < 6; ++c)
                    entries.emplace_back(int(6 * at.first) + r, int(6 * at.second) + c, m(r, c));
        Eigen::SparseMatrix<double> h(6 * Eigen::Index(n_groups()), 6 * Eigen::Index(n_groups()));
        h.setFromTriplets(entries.begin(), entries.end());
        solver_.compute(h);
    }
};

Eigen::VectorXd PoseEquations::solve_steps(const PoseTrack& track, const Eigen::VectorXd& current_corrections,
                                           double prior_weight) const {
    // Solves (H + P) x = -(g + P c). P: diagonal prior, c: current corrections.
    const std::size_t n = diagonal_.size();
    Vector6 mean = Vector6::Zero();
    for (const Matrix6& block : diagonal_) mean += block.diagonal() / double(n);
    const Vector6 pull = prior_weight * mean;  // block of P, the same for each pose
    std::vector<Eigen::LLT<Matrix6>> factorised_blocks;
    for (const Matrix6& block : diagonal_)
        // The small constant keeps the matrix of a pose without points invertible.
        factorised_blocks.emplace_back(block + Matrix6(pull.asDiagonal()) + 1e-12 * Matrix6::Identity());
    const PoseGroupEquations groups(*this, track, pull);
    const auto preconditioned = [&](const Eigen::VectorXd& r) {
        Eigen::VectorXd z(r.size());
        for (std::size_t k = 0; k < n; ++k) block_of(z, k) = factorised_blocks[k].solve(block_of(r, k));
        groups.add_group_motions(r, z);
        return z;
    };
    // r: residual of the equations, z: preconditioned residual, p: search direction.
    const Eigen::VectorXd pulls = pull.replicate(Eigen::Index(n), 1);
    Eigen::VectorXd x = Eigen::VectorXd::Zero(gradient_.size()),
                    r = -gradient_ - pulls.cwiseProduct(current_corrections), z = preconditioned(r), p = z;
    double rz = r.dot(z);
    const double final_rz = kSolverTolerance * kSolverTolerance * rz;
    for (int i = 0; i < kMaxIterations && rz > final_rz && rz > 0.0; ++i) {
        const Eigen::VectorXd q = multiply(p) + pulls.cwiseProduct(p);  // (H + P) p
        const double step = rz / p.dot(q);
        x += step * p;
        r -= step * q;
        z = preconditioned(r);
        const double next_rz = r.dot(z);
        p = z + next_rz / rz * p;
        rz = next_rz;
    }
    return x;
}

}  // namespace relidar
