// SPDX-License-Identifier: Apache-2.0
// A map that grows with every scan. Each cell of a grid holds sums that determine the
// plane of its points. So adding a point and finding a plane take constant time.
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
    /// Adds a point.
    /// @param travelled_m  distance that the sensor had travelled when the point was
    /// measured
    void add(const glm::dvec3& point_m, double travelled_m);
    /// Returns the plane of the cell that contains a point. Returns null if the cell's
    /// points do not cover a surface or scatter too much across it. Can be called from
    /// several threads.
    const Plane* at(const glm::dvec3& point_m) const;
    /// Removes cells whose last point was added at a smaller travelled distance.
    void forget(double travelled_m);

private:
    struct Cell {
        PlaneSums sums;  ///< relative to the centre of the cell
        double travelled_m = 0.0;
        /// number of points when `plane` was fitted; written after `plane`
        mutable std::atomic<double> n_fitted = 0.0;
        mutable std::optional<Plane> plane;

        bool is_outgrown() const {
            constexpr double kRefit = 1.1;  // growth after which a plane is fitted again
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
