// SPDX-License-Identifier: Apache-2.0
// Map of planes that grows scan by scan. Each cell of a grid stores sums over its points,
// from which the plane of the cell is computed. Adding a point and looking up a plane
// take constant time.
#pragma once

#include <atomic>
#include <optional>
#include <unordered_map>

#include "base/plane_sums.hpp"
#include "log/registration/plane_cells.hpp"

namespace relidar {

class VoxelPlanes {
public:
    explicit VoxelPlanes(double cell_m) : cell_m_(cell_m) {}

    bool empty() const { return cells_.empty(); }
    /// Adds a point to its cell.
    /// @param travelled_m distance that the sensor had driven when it measured the point
    void add(const glm::dvec3& point_m, double travelled_m);
    /// Returns the plane of the cell that contains a point. Returns null if the points of
    /// the cell do not form a plane. Several threads can call this function at the same
    /// time.
    const Plane* at(const glm::dvec3& point_m) const;
    /// Removes cells whose last point was measured before the sensor had driven
    /// `travelled_m`.
    void remove_old_cells(double travelled_m);

private:
    struct Cell {
        PlaneSums sums;  ///< sums relative to the centre of the cell
        double travelled_m = 0.0;
        /// number of points when `plane` was fitted; stored after `plane` is written
        mutable std::atomic<double> n_fitted = 0.0;
        mutable std::optional<Plane> plane;

        bool has_too_many_points() const {
            // The plane is fitted again when the number of points has grown by this
            // factor.
            constexpr double kRefit = 1.1;
            return sums.n >= kRefit * n_fitted.load(std::memory_order_acquire);
        }
    };
    double cell_m_;
    std::unordered_map<std::uint64_t, Cell> cells_;

    glm::dvec3 centre(const glm::dvec3& point_m) const {
        return (glm::floor(point_m / cell_m_) + 0.5) * cell_m_;
    }
    void fit(const Cell& cell, const glm::dvec3& centre_m) const;
};

}  // namespace relidar
