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
    return glm::dvec3(eigenvalues[0], eigenvalues[1], eigenvalues[2]) / sum;
}

/// Result of an iteratively reweighted fit.
struct RobustPlane {
    LocalPlane plane;
    double n_inliers = 0.0;    ///< number of points closer to the plane than the kernel scale
    double weight_sum = 0.0;   ///< sum of the weights of all points
    double variance_m2 = 0.0;  ///< variance of the points along the narrower direction of the plane
};

/// Fits a plane by iteratively reweighted least squares.
/// @param min_inliers  stops if fewer points are inliers, because refits would not help
RobustPlane fit_robust_plane(const std::vector<WorldPointWithOrigin>& points,
                             std::span<const std::uint32_t> point_indices, double scale_m,
                             double min_inliers) {
    std::vector<double> weight;
    for (const std::uint32_t i : point_indices) weight.push_back(points[i].weight);
    RobustPlane fit;
    for (int refit = 0; refit < kPlaneRefits; ++refit) {
        const glm::dvec3 variances_m2 = fit_weighted_plane(points, point_indices, weight, fit.plane);
        fit.variance_m2 = variances_m2.y;
        fit.n_inliers = fit.weight_sum = 0.0;
        double n = 0.0, squares_m2 = 0.0;
        for (std::size_t k = 0; k < point_indices.size(); ++k) {
            const WorldPointWithOrigin& point = points[point_indices[k]];
            const double off_m = glm::dot(fit.plane.normal, point.point_m - fit.plane.point_m);
            const double robust = robust_weight(off_m, scale_m);
            n += point.weight;
            squares_m2 += point.weight * std::min(off_m * off_m, scale_m * scale_m);
            weight[k] = point.weight * robust;
            fit.weight_sum += weight[k];
            // At a distance of scale_m from the plane, a point has the weight 1/4.
            if (robust > 0.25) ++fit.n_inliers;
        }
        // Points of another surface in the cell tilt the plane although their weights are
        // low, so they count like points at the scale of the kernel.
        fit.plane.set_tilts(n, squares_m2 / n, variances_m2.y, variances_m2.z);
        if (fit.n_inliers < min_inliers) break;
    }
    return fit;
}

/// Minimum standard deviation of the points of a plane in each direction of the plane.
double min_spread_m(double cell_size_m, double scale_m) {
    return std::max(kMinSpreadPerCell * cell_size_m, kMinSpreadPerKernel * scale_m);
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
    const auto n = double(point_indices.size());
    if (point_indices.size() < kMinPlanePoints) return std::nullopt;
    const RobustPlane fit = fit_robust_plane(points, point_indices, scale_m, kHopelessInlierShare * n);
    const double spread_m = min_spread_m(cell_size_m, scale_m);
    const bool is_wide = fit.variance_m2 > spread_m * spread_m;
    if (!is_wide || fit.n_inliers < kMinInlierShare * n) return std::nullopt;
    return fit.plane;
}

std::optional<LocalPlane> fit_smooth_plane(const std::vector<WorldPointWithOrigin>& points,
                                           std::span<const std::uint32_t> point_indices, double cell_size_m,
                                           double scale_m) {
    // The weight increases from 0 to 1 between these two values of the number of points,
    // of their mean robust weight, and of their spread / min_spread_m().
    constexpr double kPoints[] = {6.0, 24.0}, kMeanWeight[] = {0.45, 0.75}, kSpread[] = {0.75, 1.25};
    double n = 0.0;
    for (const std::uint32_t i : point_indices) n += points[i].weight;
    if (n <= kPoints[0]) return std::nullopt;
    RobustPlane fit = fit_robust_plane(points, point_indices, scale_m, 0.0);
    const double spread = std::sqrt(fit.variance_m2) / min_spread_m(cell_size_m, scale_m);
    fit.plane.weight = smooth_step(n, kPoints[0], kPoints[1]) *
                       smooth_step(fit.weight_sum / n, kMeanWeight[0], kMeanWeight[1]) *
                       smooth_step(spread, kSpread[0], kSpread[1]);
    if (!(fit.plane.weight > 0.0)) return std::nullopt;
    return fit.plane;
}

double smooth_step(double x, double begin, double end) {
    const double t = std::clamp((x - begin) / (end - begin), 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
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
