// SPDX-License-Identifier: Apache-2.0
// Map of planes that grows scan by scan. Each cell of a grid stores sums over its points,
// from which the plane of the cell is computed. Adding a point and looking up a plane
// take constant time.
#pragma once

#include <atomic>
#include <optional>
#include <unordered_map>

#include "base/geometry/plane_sums.hpp"
#include "registration/plane_cells.hpp"

namespace relidar {

/// Grid of cells with one plane each, to which points can be added at any time.
class VoxelPlaneMap {
public:
    explicit VoxelPlaneMap(double cell_m) : cell_m_(cell_m) {}

    bool empty() const { return cells_.empty(); }
    /// Adds a point to its cell.
    /// @param travelled_distance_m distance that the sensor had driven when it measured
    /// the point
    void add_point(const glm::dvec3& point_m, double travelled_distance_m);
    /// Returns the plane of the cell that contains a point, or null if its points do not
    /// form a plane. Several threads can call this function at the same time.
    const LocalPlane* find_plane_at(const glm::dvec3& point_m) const;
    /// Removes the cells that were last observed before the sensor had driven
    /// `min_travelled_distance_m`.
    void remove_before(double min_travelled_distance_m);

private:
    struct VoxelPlaneCell {
        PointMomentSums sums;  ///< sums relative to the centre of the cell
        double travelled_m = 0.0;
        /// number of points in the cell when `plane` was fitted; stored last, so that
        /// other threads never read an incomplete `plane`
        mutable std::atomic<double> n_fitted = 0.0;
        mutable std::optional<LocalPlane> plane;

        bool is_outdated() const {
            constexpr double kRefitGrowth = 1.1;  // growth of the number of points
            return sums.n >= kRefitGrowth * n_fitted.load(std::memory_order_acquire);
        }
    };
    double cell_m_;
    std::unordered_map<std::uint64_t, VoxelPlaneCell> cells_;

    glm::dvec3 cell_centre(const glm::dvec3& point_m) const {
        return (glm::floor(point_m / cell_m_) + 0.5) * cell_m_;
    }
    void refit_plane(const VoxelPlaneCell& cell, const glm::dvec3& cell_centre_m) const;
};

}  // namespace relidar
