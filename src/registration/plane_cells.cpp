// SPDX-License-Identifier: Apache-2.0
#include "registration/plane_cells.hpp"

#include <algorithm>
#include <functional>
#include <utility>

#include <Eigen/Eigenvalues>

#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"

namespace relidar {
namespace {

constexpr std::size_t kFewestPoints = 8;
constexpr int kFits = 4;
// Minimum standard deviation along the narrower direction of the plane / cell size.
constexpr double kSpread = 0.12;
// Minimum ratio of the same to the scale of the robust kernel. Rejects narrow strips,
// which a single beam produces if poses are wrong.
constexpr double kSpreadScale = 0.8;
// Minimum share of points that are closer to the plane than the scale of the robust
// kernel, at which a point has a weight of 1/4.
constexpr double kInliers = 0.7;

glm::dvec3 get_matrix_column(const Eigen::Matrix3d& matrix, int column) {
    return {matrix(0, column), matrix(1, column), matrix(2, column)};
}

/// Fits a plane to weighted points.
/// @return eigenvalues of the weighted covariance matrix, ascending
glm::dvec3 fit_weighted_plane_and_get_eigenvalues(const std::vector<WorldPointWithOrigin>& points,
                                                  std::span<const std::uint32_t> point_indices,
                                                  const std::vector<double>& weights, LocalPlane& plane) {
    double sum = 0.0;
    glm::dvec3 mean(0.0);
    for (std::size_t i = 0; i < point_indices.size(); ++i) {
        sum += weights[i];
        mean += weights[i] * points[point_indices[i]].point_m;
    }
    mean /= sum;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < point_indices.size(); ++i) {
        const glm::dvec3 d = points[point_indices[i]].point_m - mean;
        const Eigen::Vector3d e(d.x, d.y, d.z);
        covariance += weights[i] * e * e.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Matrix3d& axes = solver.eigenvectors();
    const Eigen::Vector3d& values = solver.eigenvalues();
    plane = {mean, get_matrix_column(axes, 0), get_matrix_column(axes, 1), get_matrix_column(axes, 2)};
    return glm::dvec3(values[0], values[1], values[2]) / sum;
}

}  // namespace

double compute_robust_weight(double residual_m, double kernel_scale_m) {
    const double x = residual_m / kernel_scale_m, w = 1.0 / (1.0 + x * x);
    return w * w;
}

std::optional<LocalPlane> fit_plane_robustly(const std::vector<WorldPointWithOrigin>& points,
                                             std::span<const std::uint32_t> point_indices, double cell_size_m,
                                             double kernel_scale_m) {
    if (point_indices.size() < kFewestPoints) return std::nullopt;
    std::vector<double> weight(point_indices.size(), 1.0);
    LocalPlane plane;
    double within = 0.0, spread2 = 0.0;
    for (int i = 0; i < kFits; ++i) {
        spread2 = fit_weighted_plane_and_get_eigenvalues(points, point_indices, weight, plane).y;
        within = 0.0;
        for (std::size_t k = 0; k < point_indices.size(); ++k) {
            weight[k] = compute_robust_weight(
                glm::dot(plane.normal, points[point_indices[k]].point_m - plane.point_m), kernel_scale_m);
            within += weight[k] > 0.25;
        }
        if (within < 0.3 * double(point_indices.size())) return std::nullopt;
    }
    const double spread = std::max(kSpread * cell_size_m, kSpreadScale * kernel_scale_m);
    if (!(spread2 > spread * spread) || within < kInliers * double(point_indices.size())) return std::nullopt;
    return plane;
}

PointCellGrid::PointCellGrid(const std::vector<WorldPointWithOrigin>& points, double cell_m, double shift)
    : cell_m_(cell_m), shift_m_(shift * cell_m), order_(points.size()) {
    // pairs of cell key and point index
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keyed(points.size());
    parallel_for_in_blocks(points.size(), [&](std::size_t index) {
        keyed[index] = {compute_cell_key(points[index].point_m), static_cast<std::uint32_t>(index)};
    });
    parallel_sort(keyed, std::less<>());
    for (std::size_t i = 0; i < keyed.size(); ++i) {
        order_[i] = keyed[i].second;
        if (i > 0 && keyed[i].first == keyed[i - 1].first) continue;
        key_.push_back(keyed[i].first);
        first_.push_back(i);
    }
    first_.push_back(order_.size());
}

std::optional<std::size_t> PointCellGrid::find_cell_at(const glm::dvec3& point_m) const {
    const auto matching_key = std::lower_bound(key_.begin(), key_.end(), compute_cell_key(point_m));
    if (matching_key == key_.end() || *matching_key != compute_cell_key(point_m)) return std::nullopt;
    return std::size_t(matching_key - key_.begin());
}

}  // namespace relidar
