// SPDX-License-Identifier: Apache-2.0
//   mean = c + sum d / n,   covariance = sum d d^T / n - (sum d / n) (sum d / n)^T,   the normal its axis of least variance
#include "registration/voxel_planes.hpp"

#include <cmath>

#include <Eigen/Eigenvalues>

namespace relidar {
namespace {

constexpr double kFewestPoints = 6;
constexpr double kSpread = 0.12;      // of the cell's edge: least standard deviation along the narrower axis; 0.29 fills the cell
constexpr double kThickness = 0.1;    // of the cell's edge: largest standard deviation along the normal
constexpr double kRefit = 1.1;        // growth after which a plane is fitted anew

}  // namespace

void VoxelPlanes::add(const glm::dvec3& point_m, double travelled_m) {
    Cell& cell = cells_[cell_key(point_m, cell_m_)];
    const glm::dvec3 d = point_m - centre(point_m);
    cell.n += 1.0;
    cell.sum += d;
    cell.squares += d * d;
    cell.products += glm::dvec3(d.y * d.z, d.x * d.z, d.x * d.y);
    cell.travelled_m = travelled_m;
}

const Plane* VoxelPlanes::at(const glm::dvec3& point_m) const {
    const auto found = cells_.find(cell_key(point_m, cell_m_));
    if (found == cells_.end() || found->second.n < kFewestPoints) return nullptr;
    const Cell& cell = found->second;
    if (cell.n >= kRefit * cell.n_fitted) fit(cell, centre(point_m));
    return cell.plane ? &*cell.plane : nullptr;
}

void VoxelPlanes::fit(const Cell& cell, const glm::dvec3& centre_m) const {
    const glm::dvec3 mean = cell.sum / cell.n, s = cell.squares / cell.n - mean * mean;
    const glm::dvec3 p = cell.products / cell.n - glm::dvec3(mean.y * mean.z, mean.x * mean.z, mean.x * mean.y);
    Eigen::Matrix3d covariance;
    covariance << s.x, p.z, p.y, p.z, s.y, p.x, p.y, p.x, s.z;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const auto axis = [&](int i) { return glm::dvec3(solver.eigenvectors()(0, i), solver.eigenvectors()(1, i), solver.eigenvectors()(2, i)); };
    const Eigen::Vector3d variance = solver.eigenvalues();
    cell.n_fitted = cell.n;
    cell.plane.reset();
    if (variance[1] < std::pow(kSpread * cell_m_, 2) || variance[0] > std::pow(kThickness * cell_m_, 2)) return;
    cell.plane = Plane{centre_m + mean, axis(0), axis(1), axis(2), cell.n * glm::dvec3(1.0, variance[1], variance[2])};
}

void VoxelPlanes::forget(double travelled_m) {
    std::erase_if(cells_, [&](const auto& entry) { return entry.second.travelled_m < travelled_m; });
}

}  // namespace relidar
