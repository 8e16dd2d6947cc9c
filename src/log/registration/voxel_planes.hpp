// SPDX-License-Identifier: Apache-2.0
// A map that grows scan by scan: per cell of a grid the sums from which the plane of its
// points follows, so that a scan is added, and a point asked for, in constant time.
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
    /// @param travelled_m  how far the sensor had come when the point was seen
    void add(const glm::dvec3& point_m, double travelled_m);
    /// The plane of the cell that a point lies in; null where its points spread over no
    /// surface, or are too thick for one. Several threads may ask at a time.
    const Plane* at(const glm::dvec3& point_m) const;
    /// Drops cells that were last seen before the sensor had come so far.
    void forget(double travelled_m);

private:
    struct Cell {
        PlaneSums sums;  ///< from the centre of the cell
        double travelled_m = 0.0;
        mutable std::atomic<double> n_fitted = 0.0;  ///< points in `plane`, which is written before
        mutable std::optional<Plane> plane;

        bool is_outgrown() const {
            constexpr double kRefit = 1.1;  // growth after which a plane is fitted anew
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
