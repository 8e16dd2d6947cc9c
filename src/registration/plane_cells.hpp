// SPDX-License-Identifier: Apache-2.0
// Fits planes to the points of all scans, one in each cell of a grid.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/geometry/cell_key.hpp"
#include "registration/thin_scans.hpp"

namespace relidar {

/// Interpolates cell size and scale geometrically from the first round (0) to the last.
inline FitRound blend_rounds(const FitRound& first_round_settings, const FitRound& last, double fraction) {
    return {first_round_settings.cell_m * std::pow(last.cell_m / first_round_settings.cell_m, fraction),
            first_round_settings.scale_m * std::pow(last.scale_m / first_round_settings.scale_m, fraction)};
}

/// Plane n . (p - point) = 0. u and v are two directions in the plane.
struct LocalPlane {
    glm::dvec3 point_m{0.0};  ///< weighted mean of the points on the plane
    glm::dvec3 normal{0.0}, u{0.0}, v{0.0};
    /// Standard deviations of the tilts of `normal` towards u and v.
    double tilt_u_rad = 0.0, tilt_v_rad = 0.0;

    /// Computes the tilts of a plane that was fitted to n points. The variance of a tilt:
    /// variance along the normal / (n * variance along u) + kMinTilt_rad^2
    /// Surfaces are curved and cells contain edges, so points share their errors, and
    /// more than kMaxPoints of them do not help.
    void set_tilts(double n_points, double normal_variance_m2, double u_variance_m2, double v_variance_m2) {
        constexpr double kMaxPoints = 10.0, kMinTilt_rad = 0.005;
        const double variance_m2 = std::max(normal_variance_m2, 0.0) / std::min(n_points, kMaxPoints);
        tilt_u_rad = std::sqrt(variance_m2 / u_variance_m2 + kMinTilt_rad * kMinTilt_rad);
        tilt_v_rad = std::sqrt(variance_m2 / v_variance_m2 + kMinTilt_rad * kMinTilt_rad);
    }
    double weight = 1.0;  ///< below 1 if it is uncertain that the points form a plane
};

/// Returns the weight of a residual r in a robust fit: rho'(r) / 2r for rho(r) = r^2 / (1
/// + r^2 / s^2) (Geman and McClure 1985).
double robust_weight(double residual_m, double kernel_scale_m);

/// Fits a plane by iteratively reweighted least squares. Returns nothing if the points
/// are not spread over a surface, or if too many are far from the plane.
std::optional<LocalPlane> fit_plane(const std::vector<WorldPointWithOrigin>& points,
                                    std::span<const std::uint32_t> point_indices, double cell_size_m,
                                    double kernel_scale_m);

/// Fits a plane like fit_plane(), but reduces LocalPlane::weight gradually instead of
/// rejecting the plane. So slightly different points always get a slightly different
/// plane. Returns nothing if the weight is zero.
std::optional<LocalPlane> fit_smooth_plane(const std::vector<WorldPointWithOrigin>& points,
                                           std::span<const std::uint32_t> point_indices, double cell_size_m,
                                           double kernel_scale_m);

/// Returns 0 below `begin`, 1 above `end`, and a smooth transition in between.
double smooth_step(double x, double begin, double end);

/// Sorts points into the cells of a grid.
class PointCellGrid {
public:
    /// @param shift  offset of the grid in cells, so that successive grids divide
    /// surfaces at different positions
    PointCellGrid(const std::vector<WorldPointWithOrigin>& points, double cell_m, double shift);

    std::size_t size() const { return first_.size() - 1; }
    /// Returns the indices of a cell's points, ascending.
    std::span<const std::uint32_t> points_in_cell(std::size_t cell_index) const {
        return {order_.data() + first_[cell_index], first_[cell_index + 1] - first_[cell_index]};
    }
    /// Returns nothing if the cell of the point is empty.
    std::optional<std::size_t> find_cell_at(const glm::dvec3& point_m) const;

private:
    double cell_m_, shift_m_;
    std::vector<std::uint64_t> key_;    ///< [cells] ascending
    std::vector<std::size_t> first_;    ///< [cells + 1] index into order_
    std::vector<std::uint32_t> order_;  ///< [points] indices of the points, sorted by cell

    std::uint64_t cell_key(const glm::dvec3& point_m) const { return grid_key(point_m + shift_m_, cell_m_); }
};

}  // namespace relidar
