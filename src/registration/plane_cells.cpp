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

constexpr std::size_t kMinPlanePoints = 8;
constexpr int kPlaneRefits = 4;
// Minimum standard deviation along the narrower direction of the plane / cell size.
constexpr double kMinSpreadPerCell = 0.12;
// Minimum ratio of the same to the scale of the robust kernel. Rejects narrow strips,
// which a single beam produces if poses are wrong.
constexpr double kMinSpreadPerKernel = 0.8;
// Minimum share of points that are closer to the plane than the scale of the robust
// kernel, at which a point has a weight of 1/4.
constexpr double kMinInlierShare = 0.7;

glm::dvec3 column_of(const Eigen::Matrix3d& matrix, int column) {
    return {matrix(0, column), matrix(1, column), matrix(2, column)};
}

/// Fits a plane to weighted points.
/// @return eigenvalues of the weighted covariance matrix, ascending
glm::dvec3 fit_weighted_plane(const std::vector<WorldPointWithOrigin>& points,
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
    plane = {mean, column_of(axes, 0), column_of(axes, 1), column_of(axes, 2)};
    return glm::dvec3(values[0], values[1], values[2]) / sum;
}

}  // namespace

double robust_weight(double residual_m, double scale_m) {
    const double x = residual_m / scale_m, w = 1.0 / (1.0 + x * x);
    return w * w;
}

std::optional<LocalPlane> fit_plane(const std::vector<WorldPointWithOrigin>& points,
                                    std::span<const std::uint32_t> point_indices, double cell_size_m,
                                    double scale_m) {
    if (point_indices.size() < kMinPlanePoints) return std::nullopt;
    std::vector<double> weight(point_indices.size(), 1.0);
    LocalPlane plane;
    double within = 0.0, spread2 = 0.0;
    for (int i = 0; i < kPlaneRefits; ++i) {
        // y: middle eigenvalue, the variance along the narrower direction of the plane
        spread2 = fit_weighted_plane(points, point_indices, weight, plane).y;
        within = 0.0;
        for (std::size_t k = 0; k < point_indices.size(); ++k) {
            weight[k] = robust_weight(
                glm::dot(plane.normal, points[point_indices[k]].point_m - plane.point_m), scale_m);
            // At a distance of scale_m from the plane, a point has the weight 1/4.
            within += weight[k] > 0.25;
        }
        // Such a cell contains several surfaces or none, so more iterations do not help.
        if (within < 0.3 * double(point_indices.size())) return std::nullopt;
    }
    const double spread = std::max(kMinSpreadPerCell * cell_size_m, kMinSpreadPerKernel * scale_m);
    if (!(spread2 > spread * spread) || within < kMinInlierShare * double(point_indices.size()))
        return std::nullopt;
    return plane;
}

PointCellGrid::PointCellGrid(const std::vector<WorldPointWithOrigin>& points, double cell_m, double shift)
    : cell_m_(cell_m), shift_m_(shift * cell_m), order_(points.size()) {
    // pairs of cell key and point index
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keyed(points.size());
    parallel_blocks(points.size(), [&](std::size_t index) {
        keyed[index] = {cell_key(points[index].point_m), static_cast<std::uint32_t>(index)};
    });
    // After sorting, the points of a cell are contiguous in order_. first_ stores where
    // each cell begins, and the total number at the end.
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
    const auto matching_key = std::lower_bound(key_.begin(), key_.end(), cell_key(point_m));
    if (matching_key == key_.end() || *matching_key != cell_key(point_m)) return std::nullopt;
    return std::size_t(matching_key - key_.begin());
}

}  // namespace relidar
