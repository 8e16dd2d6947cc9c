// SPDX-License-Identifier: Apache-2.0
// Maps of planes that grow scan by scan, with several cell sizes, so that scans can be
// aligned from coarse to fine. Each cell of a map stores sums over its points, from which
// its plane is computed. Adding a point and finding a plane take constant time.
#pragma once

#include <atomic>
#include <optional>
#include <unordered_map>
#include <vector>

#include "base/geometry/plane_sums.hpp"
#include "registration/plane_cells.hpp"

namespace relidar {

/// Grid of cells with one plane each, to which points can be added at any time.
class VoxelPlaneMap {
public:
    explicit VoxelPlaneMap(double cell_m) : cell_m_(cell_m) {}

    bool empty() const { return cells_.empty(); }
    void add_point(const glm::dvec3& point_m, double travelled_distance_m);
    /// Returns the plane of the cell that contains a point, or null if its points do not
    /// form a plane. Several threads can call this function at the same time.
    const LocalPlane* find_plane_at(const glm::dvec3& point_m) const;
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

class PlaneMaps {
public:
    static constexpr int kLevels = 3;

    /// @param first, last  cell size and kernel scale at the coarsest and finest level
    PlaneMaps(const FitRound& first, const FitRound& last) : first_(first), last_(last) { clear(); }

    void clear();
    bool empty() const { return maps_.front().empty(); }
    FitRound settings_of_level(int level) const {
        return blend_rounds(first_, last_, level / double(kLevels - 1));
    }
    /// Adds points that the vehicle measured after driving `travelled_distance_m`.
    void add_points(const std::vector<glm::dvec3>& points_m, double travelled_distance_m);
    /// Removes cells that got no point since the vehicle had driven this distance.
    void forget_before(double min_travelled_distance_m);
    /// Returns the plane at a point. Searches map `finest_level` first, then the coarser
    /// maps, because distant points form planes only in large cells. Can be null.
    const LocalPlane* find_plane(const glm::dvec3& point_m, int finest_level) const;

private:
    FitRound first_, last_;
    std::vector<VoxelPlaneMap> maps_;  // [kLevels]
};

}  // namespace relidar
