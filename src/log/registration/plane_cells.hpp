// SPDX-License-Identifier: Apache-2.0
// Planes of the world, one a cell of a grid, fitted to the points of all scans at their
// present poses.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/cell_key.hpp"
#include "log/registration/thin_scans.hpp"

namespace relidar {

/// Cells and kernel of a round between two others: t = 0 is the first, 1 the last,
/// geometrically.
inline RegisterRound between(const RegisterRound& first, const RegisterRound& last, double t) {
    return {first.cell_m * std::pow(last.cell_m / first.cell_m, t),
            first.scale_m * std::pow(last.scale_m / first.scale_m, t)};
}

/// n . (p - point) = 0, with the two directions within it.
struct Plane {
    glm::dvec3 point_m{0.0};  ///< weighted mean of its points
    glm::dvec3 normal{0.0}, u{0.0}, v{0.0};
};

/// rho'(r) / 2r of rho(r) = r^2 / (1 + r^2 / s^2) (Geman and McClure 1985)
double weight_of(double residual_m, double scale_m);

/// Least squares with the robust weights, iterated. Nothing where the points do not
/// spread over a surface of the cell, or too many lie off it.
std::optional<Plane> fit_plane(const std::vector<PlacedPoint>& points, std::span<const std::uint32_t> members,
                               double cell_m, double scale_m);

/// The grid at one round.
class PlaneCells {
public:
    /// @param shift of the grid in cells: other shifts cut surfaces elsewhere
    PlaneCells(const std::vector<PlacedPoint>& points, double cell_m, double shift);

    std::size_t size() const { return first_.size() - 1; }
    /// Points of a cell, ascending.
    std::span<const std::uint32_t> members(std::size_t cell) const {
        return {order_.data() + first_[cell], first_[cell + 1] - first_[cell]};
    }
    /// The cell that a point lies in, if any point of the grid does.
    std::optional<std::size_t> find(const glm::dvec3& point_m) const;

private:
    double cell_m_, shift_m_;
    std::vector<std::uint64_t> key_;    ///< [cells] ascending
    std::vector<std::size_t> first_;    ///< [cells+1] into order_
    std::vector<std::uint32_t> order_;  ///< [points]

    std::uint64_t key_of(const glm::dvec3& point_m) const { return cell_key(point_m + shift_m_, cell_m_); }
};

}  // namespace relidar
