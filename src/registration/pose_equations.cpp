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

constexpr int kMaxIterations = 100;  // usually 20 to 30 are enough, even for long logs
// Sums over planes run in parallel: at most kMaxPlaneParts sums over at least
// kMinPlanesPerPart planes.
constexpr std::size_t kMaxPlaneParts = 64, kMinPlanesPerPart = 256;
// The conjugate-gradient solver stops if the residual norm has fallen to this fraction of
// its initial value. Later Gauss-Newton steps correct the remaining error.
constexpr double kSolverTolerance = 1e-4;
// Standard deviations of the start pose of a single scan.
constexpr double kStartSigma_m = 0.2, kStartSigma_rad = 0.02;

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

/// Solves A x = b for a positive definite matrix A by conjugate gradients.
/// @param multiply  returns A times a vector
/// @param precondition  returns about the inverse of A times a vector
template <class Multiply, class Precondition>
Eigen::VectorXd solve_conjugate_gradient(const Eigen::VectorXd& b, const Multiply& multiply,
                                         const Precondition& precondition) {
    // r: residual of the equations, z: preconditioned residual, p: search direction.
    Eigen::VectorXd x = Eigen::VectorXd::Zero(b.size()), r = b, z = precondition(r), p = z;
    double rz = r.dot(z);
    const double final_rz = kSolverTolerance * kSolverTolerance * rz;
    for (int i = 0; i < kMaxIterations && rz > final_rz && rz > 0.0; ++i) {
        const Eigen::VectorXd q = multiply(p);
        const double step = rz / p.dot(q);
        x += step * p;
        r -= step * q;
        z = precondition(r);
        const double next_rz = r.dot(z);
        p = z + next_rz / rz * p;
        rz = next_rz;
    }
    return x;
}

}  // namespace

PlaneResidual make_residual(const WorldPointWithOrigin& point, const LocalPlane& plane, double scale_m) {
    PlaneResidual row;
    row.residual_m = glm::dot(plane.normal, point.point_m - plane.point_m);
    row.weight = point.weight * plane.weight * robust_weight(row.residual_m, scale_m);
    const glm::dvec3 arm_m = point.point_m - point.vehicle_m;
    const auto derivative = [&](const glm::dvec3& direction) {
        Vector6 j;
        j << to_eigen(direction), to_eigen(glm::cross(arm_m, direction));
        return j;
    };
    row.j = derivative(plane.normal);
    row.j_error << derivative(plane.tilt_u_rad * plane.u), derivative(plane.tilt_v_rad * plane.v);
    return row;
}

void SinglePoseEquations::add_residual(const PlaneResidual& plane_residual, double pose_motion_fraction) {
    const double weight = plane_residual.weight * pose_motion_fraction * pose_motion_fraction;
    stiffness_ += weight * plane_residual.j * plane_residual.j.transpose();
    noise_ += weight * plane_residual.j_error * plane_residual.j_error.transpose();
    gradient_ += plane_residual.weight * pose_motion_fraction * plane_residual.residual_m * plane_residual.j;
    n_on_planes_ += plane_residual.is_on_plane();
}

SinglePoseEquations& SinglePoseEquations::operator+=(const SinglePoseEquations& other) {
    stiffness_ += other.stiffness_;
    noise_ += other.noise_;
    gradient_ += other.gradient_;
    n_on_planes_ += other.n_on_planes_;
    return *this;
}

double SinglePoseEquations::move_pose(Pose& pose, const Pose& start,
                                      const std::vector<UnobservedMotion>& unobserved) const {
    if (empty()) return 0.0;
    // Solves (H + P) x = -(g + P c). H: stiffness, g: gradient, P: prior, c: correction
    // so far. P is weak, except for motions that the points do not show.
    Matrix6 prior = hold_stiffness(unobserved);
    prior.diagonal().head<3>().array() += point_weight(kStartSigma_m);
    prior.diagonal().tail<3>().array() += point_weight(kStartSigma_rad);
    const Vector6 gradient = gradient_ + prior * to_vector(compute_twist(start, pose));
    const Vector6 step = -(stiffness_ + prior).llt().solve(gradient);
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
      off_diagonal_(n_poses, Matrix6::Zero()),
      noise_(n_poses, Matrix6::Zero()),
      n_on_planes_(n_poses, 0),
      gradient_(Eigen::VectorXd::Zero(6 * Eigen::Index(n_poses))) {}

void PoseEquations::add_point(const SubsampledPoint& point, const PlaneResidual& plane_residual) {
    // A residual's derivative by a pose is s j, where s is the weight of the pose in the
    // interpolation. So block (i, k) of the matrix gets s_i s_k w j j^T.
    const auto [before, after] = poses_of_point(point);
    const Matrix6 w_j_jt = plane_residual.weight * plane_residual.j * plane_residual.j.transpose();
    const Matrix6 noise = plane_residual.weight * plane_residual.j_error * plane_residual.j_error.transpose();
    for (const auto& [pose, s] : {before, after}) {
        if (s == 0.0) continue;
        block_of(gradient_, pose) += plane_residual.weight * plane_residual.residual_m * s * plane_residual.j;
        diagonal_[pose] += s * s * w_j_jt;
        noise_[pose] += s * s * noise;
    }
    // Block (before, after). Its transpose below the diagonal is not stored.
    off_diagonal_[before.first] += before.second * after.second * w_j_jt;
    cost_ += plane_residual.weight * plane_residual.residual_m * plane_residual.residual_m;
    weight_ += plane_residual.weight;
    n_on_planes_[point.pose] += plane_residual.is_on_plane();
}

void PoseEquations::add_cell(const std::vector<SubsampledPoint>& points,
                             const std::vector<WorldPointWithOrigin>& world_points,
                             std::span<const std::uint32_t> point_indices, const LocalPlane& plane,
                             double scale_m) {
    // The steps x of the poses and p of the plane minimise the sum of w (r + J x + b p)^2
    // over the points. b: plane_jacobian(). They solve
    //   T x + C p = -g,   C^T x + S p = -h,   S = L L^T
    // Eliminating p leaves (T - c c^T) x = -(g - c L^-1 h) with c = C L^-T. The points
    // need the same weights w in all sums, otherwise T - c c^T is not positive definite.
    Eigen::Matrix3d plane_matrix = Eigen::Matrix3d::Zero();    // S, the sum of w b b^T
    Eigen::Vector3d plane_gradient = Eigen::Vector3d::Zero();  // h, the sum of w r b
    for (const std::uint32_t i : point_indices) {
        const PlaneResidual row = make_residual(world_points[i], plane, scale_m);
        const Eigen::Vector3d b = plane_jacobian(world_points[i], plane);
        plane_matrix += row.weight * b * b.transpose();
        plane_gradient += row.weight * row.residual_m * b;
    }
    const Eigen::LLT<Eigen::Matrix3d> cholesky(plane_matrix);
    if (cholesky.info() != Eigen::Success) return;
    const auto times_inverse_l = [&](const Eigen::Vector3d& b) -> Eigen::Vector3d {
        return cholesky.matrixL().solve(b);
    };
    const std::size_t begin = couplings_.size();
    // Finds or adds block c of a pose. Starts with the last, as points are almost sorted.
    const auto find_coupling = [&](std::size_t pose) -> Eigen::Matrix<float, 6, 3>& {
        for (std::size_t k = couplings_.size(); k-- > begin;)
            if (couplings_[k].pose == pose) return couplings_[k].c;
        couplings_.push_back({static_cast<std::uint32_t>(pose), Eigen::Matrix<float, 6, 3>::Zero()});
        return couplings_.back().c;
    };
    for (const std::uint32_t i : point_indices) {
        const PlaneResidual row = make_residual(world_points[i], plane, scale_m);
        add_point(points[i], row);  // adds to T and g
        const Eigen::Vector3d b = times_inverse_l(plane_jacobian(world_points[i], plane));
        for (const auto& [pose, s] : poses_of_point(points[i]))
            if (s != 0.0) find_coupling(pose) += (s * row.weight * row.j * b.transpose()).cast<float>();
    }
    for (std::size_t k = begin; k < couplings_.size(); ++k)
        block_of(gradient_, couplings_[k].pose) -=
            couplings_[k].c.cast<double>() * times_inverse_l(plane_gradient);
    plane_end_.push_back(couplings_.size());
}

/// Adds the equations of other cells, for the same poses, and empties `other`.
void PoseEquations::add_equations(PoseEquations&& other) {
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        diagonal_[k] += other.diagonal_[k];
        off_diagonal_[k] += other.off_diagonal_[k];
        noise_[k] += other.noise_[k];
        n_on_planes_[k] += other.n_on_planes_[k];
    }
    gradient_ += other.gradient_;
    // `plane_end_` refers to `couplings_`, where those of the other planes follow.
    for (const std::size_t end : other.plane_end_) plane_end_.push_back(couplings_.size() + end);
    couplings_.insert(couplings_.end(), other.couplings_.begin(), other.couplings_.end());
    cost_ += other.cost_;
    weight_ += other.weight_;
    other = PoseEquations(0);  // frees the memory of `other`
}

void PoseEquations::add_zero_prior(std::size_t pose, const Vector6& weights, const Vector6& correction) {
    diagonal_[pose].diagonal() += weights;
    block_of(gradient_, pose) += weights.cwiseProduct(correction);
}

void PoseEquations::add_motion_prior(std::size_t pose, const Matrix6& weights, const glm::dvec3& offset_m,
                                     const Vector6& difference) {
    // The next pose moves with its pose like one rigid body, so the residual of the term
    // is difference + x_next - carry x.
    const Matrix6 carry = twist_transfer(offset_m), carry_t_weights = carry.transpose() * weights;
    diagonal_[pose] += carry_t_weights * carry;
    diagonal_[pose + 1] += weights;
    off_diagonal_[pose] -= carry_t_weights;
    block_of(gradient_, pose) -= carry_t_weights * difference;
    block_of(gradient_, pose + 1) += weights * difference;
}

std::vector<std::vector<UnobservedMotion>> PoseEquations::find_unobserved(double min_information) const {
    std::vector<Matrix6> information = diagonal_;
    for (const PlanePoseCoupling& coupling : couplings_) {
        const Eigen::Matrix<double, 6, 3> c = coupling.c.cast<double>();
        information[coupling.pose] -= c * c.transpose();
    }
    std::vector<std::vector<UnobservedMotion>> motions(information.size());
    for (std::size_t k = 0; k < information.size(); ++k)
        motions[k] = relidar::find_unobserved(information[k], noise_[k], min_information);
    return motions;
}

/// Computes H x with H = T - sum over planes of c c^T. T has the blocks diagonal_ and
/// off_diagonal_, because a point connects only neighbouring poses. c has the couplings
/// of a plane, a block of 6 x 3 for each pose that sees it.
Eigen::VectorXd PoseEquations::multiply(const Eigen::VectorXd& x) const {
    Eigen::VectorXd y = Eigen::VectorXd::Zero(x.size());
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        block_of(y, k) += diagonal_[k] * block_of(x, k);
        if (k + 1 == diagonal_.size()) break;
        block_of(y, k) += off_diagonal_[k] * block_of(x, k + 1);
        block_of(y, k + 1) += off_diagonal_[k].transpose() * block_of(x, k);
    }
    if (n_planes() == 0) return y;
    const std::size_t part_size = std::max(kMinPlanesPerPart, n_planes() / kMaxPlaneParts + 1);
    y -= parallel_sum(n_planes(), part_size, [&](std::size_t first, std::size_t last) {
        Eigen::VectorXd part = Eigen::VectorXd::Zero(x.size());  // sum of c (c^T x)
        for (std::size_t plane = first; plane < last; ++plane) {
            Eigen::Vector3d c_times_x = Eigen::Vector3d::Zero();
            for (const PlanePoseCoupling& coupling : couplings_of(plane))
                c_times_x += coupling.c.cast<double>().transpose() * block_of(x, coupling.pose);
            for (const PlanePoseCoupling& coupling : couplings_of(plane))
                block_of(part, coupling.pose) += coupling.c.cast<double>() * c_times_x;
        }
        return part;
    });
    return y;
}

/// Equations for groups of eight consecutive poses, each of which moves like one rigid
/// body. They are small enough for a direct solution.
class PoseGroupEquations {
public:
    /// Sums the equations of the poses: a motion g of a group moves its pose k by the
    /// twist A_k g (carry_), so block (j, k) of the poses becomes A_j^T block A_k.
    PoseGroupEquations(const PoseEquations& equations, const PoseTrack& track)
        : n_(equations.diagonal_.size()) {
        for (std::size_t k = 0; k < n_; ++k)
            carry_.push_back(twist_transfer(track.pose[k].translation -
                                            track.pose[k / kPosesPerGroup * kPosesPerGroup].translation));
        for (std::size_t k = 0; k < n_; ++k) {
            const std::size_t group = k / kPosesPerGroup, next_group = (k + 1) / kPosesPerGroup;
            find_block(group, group) += carry_[k].transpose() * equations.diagonal_[k] * carry_[k];
            if (k + 1 == n_) break;
            const Matrix6 pair_matrix = carry_[k].transpose() * equations.off_diagonal_[k] * carry_[k + 1];
            find_block(group, next_group) += pair_matrix;
            find_block(next_group, group) += pair_matrix.transpose();
        }
        for (std::size_t plane = 0; plane < equations.n_planes(); ++plane)
            subtract_plane(equations.couplings_of(plane));
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
    std::vector<Matrix6> carry_;  // [poses] converts the twist of the group to that of the pose
    std::map<std::pair<std::size_t, std::size_t>, Matrix6> blocks_;  // key: row, column
    Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> solver_;

    std::size_t n_groups() const { return (n_ + kPosesPerGroup - 1) / kPosesPerGroup; }
    Matrix6& find_block(std::size_t row, std::size_t column) {
        return blocks_.try_emplace({row, column}, Matrix6::Zero()).first->second;
    }

    /// Subtracts the term c c^T of a plane. First adds up its couplings with the poses of
    /// each group, because these move together.
    void subtract_plane(std::span<const PoseEquations::PlanePoseCoupling> couplings) {
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

/// Solves H x = -g for the steps x of all poses. H: multiply(), g: gradient_.
Eigen::VectorXd PoseEquations::solve_steps(const PoseTrack& track) const {
    // The preconditioner, about the inverse of H, solves each pose alone, and adds a
    // solution in which groups of poses move like rigid bodies.
    std::vector<Eigen::LLT<Matrix6>> factorised_blocks;
    for (const Matrix6& block : diagonal_)
        // The small constant keeps the matrix of a pose without points invertible.
        factorised_blocks.emplace_back(block + 1e-12 * Matrix6::Identity());
    const PoseGroupEquations groups(*this, track);
    const auto precondition = [&](const Eigen::VectorXd& r) {
        Eigen::VectorXd z(r.size());
        for (std::size_t k = 0; k < diagonal_.size(); ++k)
            block_of(z, k) = factorised_blocks[k].solve(block_of(r, k));
        groups.add_group_motions(r, z);
        return z;
    };
    return solve_conjugate_gradient(
        -gradient_, [&](const Eigen::VectorXd& p) { return multiply(p); }, precondition);
}

}  // namespace relidar
