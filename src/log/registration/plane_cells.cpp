// SPDX-License-Identifier: Apache-2.0
#include "log/registration/plane_cells.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <Eigen/Eigenvalues>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr std::size_t kFewestPoints = 8;
constexpr int kFits = 4;
// Points form a plane only if they spread over the cell. This is the minimum standard
// deviation along their narrower axis, divided by the cell size. A full cell has 0.29.
constexpr double kSpread = 0.12;
// Minimum standard deviation of points along the narrower axis of a plane, divided by the
// scale of the robust kernel. With wrong poses, the points of a single beam form a
// narrower ribbon, which is not a surface.
constexpr double kSpreadScale = 0.8;
// minimum share of points that are closer to the plane than the scale of the robust
// kernel
constexpr double kInliers = 0.7;

glm::dvec3 vector(const Eigen::Matrix3d& axes, int column) {
    return {axes(0, column), axes(1, column), axes(2, column)};
}

/// Fits a plane to weighted points.
/// @return eigenvalues of the weighted covariance matrix, ascending
glm::dvec3 fit_once(const std::vector<PlacedPoint>& points, std::span<const std::uint32_t> members,
                    const std::vector<double>& weight, Plane& plane) {
    double sum = 0.0;
    glm::dvec3 mean(0.0);
    for (std::size_t i = 0; i < members.size(); ++i) {
        sum += weight[i];
        mean += weight[i] * points[members[i]].point_m;
    }
    mean /= sum;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < members.size(); ++i) {
        const glm::dvec3 d = points[members[i]].point_m - mean;
        const Eigen::Vector3d e(d.x, d.y, d.z);
        covariance += weight[i] * e * e.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Matrix3d axes = solver.eigenvectors();
    const Eigen::Vector3d values = solver.eigenvalues();
    plane = {mean, vector(axes, 0), vector(axes, 1), vector(axes, 2)};
    return glm::dvec3(values[0], values[1], values[2]) / sum;
}

}  // namespace

double compute_weight(double residual_m, double scale_m) {
    const double x = residual_m / scale_m, w = 1.0 / (1.0 + x * x);
    return w * w;
}

std::optional<Plane> fit_plane(const std::vector<PlacedPoint>& points, std::span<const std::uint32_t> members,
                               double cell_m, double scale_m) {
    if (members.size() < kFewestPoints) return std::nullopt;
    std::vector<double> weight(members.size(), 1.0);
    Plane plane;
    double within = 0.0, spread2 = 0.0;
    for (int i = 0; i < kFits; ++i) {
        spread2 = fit_once(points, members, weight, plane).y;
        within = 0.0;
        for (std::size_t k = 0; k < members.size(); ++k) {
            weight[k] =
                compute_weight(glm::dot(plane.normal, points[members[k]].point_m - plane.point_m), scale_m);
            within += weight[k] > 0.25;
        }
        if (within < 0.3 * double(members.size())) return std::nullopt;
    }
    const double spread = std::max(kSpread * cell_m, kSpreadScale * scale_m);
    if (!(spread2 > spread * spread) || within < kInliers * double(members.size())) return std::nullopt;
    return plane;
}

PlaneCells::PlaneCells(const std::vector<PlacedPoint>& points, double cell_m, double shift)
    : cell_m_(cell_m), shift_m_(shift * cell_m), order_(points.size()) {
    // pairs of cell key and point index
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keyed(points.size());
    for_each_block(points.size(), [&](std::size_t index) {
        keyed[index] = {key_of(points[index].point_m), static_cast<std::uint32_t>(index)};
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

std::optional<std::size_t> PlaneCells::find(const glm::dvec3& point_m) const {
    const auto found = std::lower_bound(key_.begin(), key_.end(), key_of(point_m));
    if (found == key_.end() || *found != key_of(point_m)) return std::nullopt;
    return std::size_t(found - key_.begin());
}

}  // namespace relidar
