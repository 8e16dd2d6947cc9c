// SPDX-License-Identifier: Apache-2.0
#include "registration/pose_equations.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>

namespace relidar {
namespace {

constexpr int kMostIterations = 300;
constexpr double kTolerance = 1e-4;   // of the residual's norm: the next round corrects what is left

Eigen::Vector3d to_eigen(const glm::dvec3& v) { return {v.x, v.y, v.z}; }

/// The poses that a point moves with, and how much.
std::array<std::pair<std::size_t, double>, 2> shares(const ThinPoint& point) {
    return {{{point.left, 1.0 - double(point.s)}, {point.left + 1, double(point.s)}}};
}

/// Of a point's residual, by offset and tilts of its plane.
Eigen::Vector3d row_of_plane(const PlacedPoint& point, const Plane& plane) {
    const glm::dvec3 d = point.point_m - plane.point_m;
    return {1.0, glm::dot(plane.u, d), glm::dot(plane.v, d)};
}

}  // namespace

Row row_of(const PlacedPoint& point, const Plane& plane, double scale_m) {
    Row row;
    row.residual_m = glm::dot(plane.normal, point.point_m - plane.point_m);
    row.weight = weight_of(row.residual_m, scale_m);
    row.j << to_eigen(plane.normal), to_eigen(glm::cross(point.point_m - point.sensor_m, plane.normal));
    return row;
}

PoseEquations::PoseEquations(std::size_t n_poses)
    : diagonal_(n_poses, Matrix6::Zero()), next_(n_poses, Matrix6::Zero()), gradient_(Eigen::VectorXd::Zero(6 * Eigen::Index(n_poses))) {}

void PoseEquations::add_point(const ThinPoint& point, const Row& row) {
    const auto [a, b] = shares(point);
    const Matrix6 square = row.weight * row.j * row.j.transpose();
    for (const auto& [pose, share] : {a, b}) {
        if (share == 0.0) continue;
        gradient_.segment<6>(6 * Eigen::Index(pose)) += row.weight * row.residual_m * share * row.j;
        diagonal_[pose] += share * share * square;
    }
    next_[a.first] += a.second * b.second * square;
    cost_ += row.weight * row.residual_m * row.residual_m;
    weight_ += row.weight;
}

void PoseEquations::add_cell(const std::vector<ThinPoint>& points, const std::vector<PlacedPoint>& placed,
                             std::span<const std::uint32_t> members, const Plane& plane, double scale_m) {
    const std::size_t begin = couplings_.size();
    const auto coupling = [&](std::size_t pose) -> Coupling& {   // members ascend, and so do, almost, their poses
        for (std::size_t k = couplings_.size(); k-- > begin;)
            if (couplings_[k].pose == pose) return couplings_[k];
        return couplings_.emplace_back(Coupling{static_cast<std::uint32_t>(pose), Eigen::Matrix<float, 6, 3>::Zero()});
    };
    // of the plane's own unknowns, with the weights that its points have now: with those of its fit H would not be positive
    Eigen::Matrix3d stiffness = Eigen::Matrix3d::Zero();
    Eigen::Vector3d pull = Eigen::Vector3d::Zero();
    for (const std::uint32_t i : members) {
        const Row row = row_of(placed[i], plane, scale_m);
        const Eigen::Vector3d b = row_of_plane(placed[i], plane);
        stiffness += row.weight * b * b.transpose();
        pull += row.weight * row.residual_m * b;
    }
    const Eigen::LLT<Eigen::Matrix3d> root(stiffness);
    if (root.info() != Eigen::Success) return;
    const auto whitened = [&](const Eigen::Vector3d& b) -> Eigen::Vector3d { return root.matrixL().solve(b); };
    for (const std::uint32_t i : members) {
        const Row row = row_of(placed[i], plane, scale_m);
        add_point(points[i], row);
        const Eigen::Vector3d b = whitened(row_of_plane(placed[i], plane));
        for (const auto& [pose, share] : shares(points[i]))
            if (share != 0.0) coupling(pose).c += (share * row.weight * row.j * b.transpose()).cast<float>();
    }
    for (std::size_t k = begin; k < couplings_.size(); ++k)
        gradient_.segment<6>(6 * Eigen::Index(couplings_[k].pose)) -= couplings_[k].c.cast<double>() * whitened(pull);
    plane_end_.push_back(couplings_.size());
    ++n_planes_;
}

void PoseEquations::add(PoseEquations&& other) {
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        diagonal_[k] += other.diagonal_[k];
        next_[k] += other.next_[k];
    }
    gradient_ += other.gradient_;
    for (const std::size_t end : other.plane_end_) plane_end_.push_back(couplings_.size() + end);
    couplings_.insert(couplings_.end(), other.couplings_.begin(), other.couplings_.end());
    n_planes_ += other.n_planes_;
    cost_ += other.cost_;
    weight_ += other.weight_;
}

Eigen::VectorXd PoseEquations::times(const Eigen::VectorXd& x) const {
    Eigen::VectorXd y = Eigen::VectorXd::Zero(x.size());
    const auto block = [](auto& vector, std::size_t pose) { return vector.template segment<6>(6 * Eigen::Index(pose)); };
    for (std::size_t k = 0; k < diagonal_.size(); ++k) {
        block(y, k) += diagonal_[k] * block(x, k);
        if (k + 1 == diagonal_.size()) break;
        block(y, k) += next_[k] * block(x, k + 1);
        block(y, k + 1) += next_[k].transpose() * block(x, k);
    }
    std::size_t begin = 0;
    for (const std::size_t end : plane_end_) {
        Eigen::Vector3d moved = Eigen::Vector3d::Zero();
        for (std::size_t k = begin; k < end; ++k) moved += couplings_[k].c.cast<double>().transpose() * block(x, couplings_[k].pose);
        for (std::size_t k = begin; k < end; ++k) block(y, couplings_[k].pose) -= couplings_[k].c.cast<double>() * moved;
        begin = end;
    }
    return y;
}

Eigen::VectorXd PoseEquations::solve(const Eigen::VectorXd& correction, double prior) const {
    const std::size_t n = diagonal_.size();
    Matrix6 mean = Matrix6::Zero();
    for (const Matrix6& d : diagonal_) mean += d / double(n);
    const Vector6 pull = prior * mean.diagonal();
    std::vector<Eigen::LLT<Matrix6>> inverse;
    for (const Matrix6& d : diagonal_) inverse.emplace_back(d + Matrix6(pull.asDiagonal()) + 1e-12 * Matrix6::Identity());
    const auto preconditioned = [&](const Eigen::VectorXd& r) {
        Eigen::VectorXd z(r.size());
        for (std::size_t k = 0; k < n; ++k) z.segment<6>(6 * Eigen::Index(k)) = inverse[k].solve(r.segment<6>(6 * Eigen::Index(k)));
        return z;
    };
    const Eigen::VectorXd pulls = pull.replicate(Eigen::Index(n), 1);
    Eigen::VectorXd x = Eigen::VectorXd::Zero(gradient_.size()), r = -gradient_ - pulls.cwiseProduct(correction), z = preconditioned(r),
                    p = z;
    const double start = r.dot(z);
    double rz = start;
    for (int i = 0; i < kMostIterations && rz > kTolerance * kTolerance * start && rz > 0.0; ++i) {
        const Eigen::VectorXd q = times(p) + pulls.cwiseProduct(p);
        const double step = rz / p.dot(q);
        x += step * p;
        r -= step * q;
        z = preconditioned(r);
        const double next = r.dot(z);
        p = z + next / rz * p;
        rz = next;
    }
    return x;
}

}  // namespace relidar
