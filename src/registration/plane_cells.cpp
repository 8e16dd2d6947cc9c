// SPDX-License-Identifier: Apache-2.0
#include "registration/plane_cells.hpp"

#include <algorithm>
#include <compare>
#include <functional>
#include <utility>

#include <Eigen/Eigenvalues>

#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"

namespace relidar {
namespace {

constexpr std::size_t kMinPlanePoints = 8;
constexpr int kPlaneRefits = 4;
constexpr double kMinSpreadPerCell = 0.12;  // minimum standard deviation along the plane / cell size
// Minimum ratio of the same to the scale of the robust kernel. Rejects narrow strips,
// which a single beam produces if poses are wrong.
constexpr double kMinSpreadPerKernel = 0.8;
// Minimum share of points that are closer to the plane than the scale of the robust
// kernel, at which a point has a weight of 1/4.
constexpr double kMinInlierShare = 0.7;

glm::dvec3 column_of(const Eigen::Matrix3d& matrix, int column) {
    return {matrix(0, column), matrix(1, column), matrix(2, column)};
}

/// Fits a plane to weighted points: through their mean, along the two axes of their
/// covariance matrix with the largest variances.
/// @param weights  of the points `point_indices`
/// @param plane  output
/// @return the three variances (eigenvalues of the matrix), ascending
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
        const glm::dvec3 offset = points[point_indices[i]].point_m - mean;
        const Eigen::Vector3d d(offset.x, offset.y, offset.z);
        covariance += weights[i] * d * d.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Matrix3d& axes = solver.eigenvectors();
    const Eigen::Vector3d& eigenvalues = solver.eigenvalues();
    plane = {.point_m = mean, .normal = column_of(axes, 0), .u = column_of(axes, 1), .v = column_of(axes, 2)};
    plane.set_tilts(sum, eigenvalues[0], eigenvalues[1], eigenvalues[2]);
    return glm::dvec3(eigenvalues[0], eigenvalues[1], eigenvalues[2]) / sum;
}

}  // namespace

double robust_weight(double residual_m, double scale_m) {
    const double x = residual_m / scale_m, w = 1.0 / (1.0 + x * x);
    return w * w;
}

std::optional<LocalPlane> fit_plane(const std::vector<WorldPointWithOrigin>& points,
                                    std::span<const std::uint32_t> point_indices, double cell_size_m,
                                    double scale_m) {
    // With fewer inliers, a cell has several surfaces or none: refits do not help.
    constexpr double kHopelessInlierShare = 0.3;
    const std::size_t n = point_indices.size();
    if (n < kMinPlanePoints) return std::nullopt;
    std::vector<double> weight(n, 1.0);
    LocalPlane plane;
    double n_inliers = 0.0, variance_m2 = 0.0;
    for (int refit = 0; refit < kPlaneRefits; ++refit) {
        // y: the middle variance, along the narrower direction of the plane
        variance_m2 = fit_weighted_plane(points, point_indices, weight, plane).y;
        n_inliers = 0.0;
        for (std::size_t k = 0; k < n; ++k) {
            const glm::dvec3 offset_m = points[point_indices[k]].point_m - plane.point_m;
            weight[k] = robust_weight(glm::dot(plane.normal, offset_m), scale_m);
            // At a distance of scale_m from the plane, a point has the weight 1/4.
            if (weight[k] > 0.25) ++n_inliers;
        }
        if (n_inliers < kHopelessInlierShare * double(n)) return std::nullopt;
    }
    const double min_spread_m = std::max(kMinSpreadPerCell * cell_size_m, kMinSpreadPerKernel * scale_m);
    const bool is_wide = variance_m2 > min_spread_m * min_spread_m;
    if (!is_wide || n_inliers < kMinInlierShare * double(n)) return std::nullopt;
    return plane;
}

/// Sorts the points by cell and, within a cell, by index.
PointCellGrid::PointCellGrid(const std::vector<WorldPointWithOrigin>& points, double cell_m, double shift)
    : cell_m_(cell_m), shift_m_(shift * cell_m), order_(points.size()) {
    struct KeyedPoint {
        std::uint64_t cell;
        std::uint32_t point;
        auto operator<=>(const KeyedPoint&) const = default;
    };
    std::vector<KeyedPoint> keyed(points.size());
    parallel_blocks(points.size(), [&](std::size_t index) {
        keyed[index] = {cell_key(points[index].point_m), static_cast<std::uint32_t>(index)};
    });
    // After sorting, the points of a cell are contiguous in order_. first_ stores where
    // each cell begins, and the total number at the end.
    parallel_sort(keyed, std::less<>());
    for (std::size_t i = 0; i < keyed.size(); ++i) {
        order_[i] = keyed[i].point;
        const bool is_new_cell = i == 0 || keyed[i].cell != keyed[i - 1].cell;
        if (!is_new_cell) continue;
        key_.push_back(keyed[i].cell);
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
