// SPDX-License-Identifier: Apache-2.0
// Planes in the world frame, one per grid cell, fitted to the points of all scans at
// their current poses.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/cell_key.hpp"
#include "log/registration/thin_scans.hpp"

namespace relidar {

/// Interpolates cell size and kernel scale between two rounds geometrically. t = 0 is the
/// first round, 1 the last.
inline RegisterRound between(const RegisterRound& first, const RegisterRound& last, double t) {
    return {first.cell_m * std::pow(last.cell_m / first.cell_m, t),
            first.scale_m * std::pow(last.scale_m / first.scale_m, t)};
}

/// A plane n . (p - point) = 0, with two directions u and v within the plane.
struct Plane {
    glm::dvec3 point_m{0.0};  ///< weighted mean of the points
    glm::dvec3 normal{0.0}, u{0.0}, v{0.0};
};

/// Returns the weight rho'(r) / 2r of rho(r) = r^2 / (1 + r^2 / s^2) (Geman and McClure
/// 1985).
double weight_of(double residual_m, double scale_m);

/// Fits a plane by iterated least squares with robust weights. Returns nothing if the
/// points do not cover a surface of the cell, or if too many points lie off the plane.
std::optional<Plane> fit_plane(const std::vector<PlacedPoint>& points, std::span<const std::uint32_t> members,
                               double cell_m, double scale_m);

/// Points sorted into the cells of a grid.
class PlaneCells {
public:
    /// Sorts points into cells.
    /// @param shift  offset of the grid in cells; different offsets cut surfaces at
    /// different places
    PlaneCells(const std::vector<PlacedPoint>& points, double cell_m, double shift);

    std::size_t size() const { return first_.size() - 1; }
    /// Returns the indices of the points of a cell, ascending.
    std::span<const std::uint32_t> members(std::size_t cell) const {
        return {order_.data() + first_[cell], first_[cell + 1] - first_[cell]};
    }
    /// Returns the cell that contains a point, or nothing if the cell has no points.
    std::optional<std::size_t> find(const glm::dvec3& point_m) const;

private:
    double cell_m_, shift_m_;
    std::vector<std::uint64_t> key_;    ///< [cells] ascending
    std::vector<std::size_t> first_;    ///< [cells+1] into order_
    std::vector<std::uint32_t> order_;  ///< [points]

    std::uint64_t key_of(const glm::dvec3& point_m) const { return cell_key(point_m + shift_m_, cell_m_); }
};

}  // namespace relidar
