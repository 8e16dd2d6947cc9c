// SPDX-License-Identifier: Apache-2.0
// Stores maps of planes with several cell sizes, so that scans can be aligned from coarse
// to fine.
#pragma once

#include <vector>

#include "base/parallel.hpp"
#include "log/registration/voxel_planes.hpp"

namespace relidar {

class LevelMaps {
public:
    static constexpr int kLevels = 3;

    /// Creates an empty map for each cell size. Levels go from coarse to fine.
    /// @param first, last cell size and scale of the robust kernel at the coarsest and at
    /// the finest level
    LevelMaps(const RegisterRound& first, const RegisterRound& last) : first_(first), last_(last) { clear(); }

    void clear() {
        maps_.clear();
        for (int level = 0; level < kLevels; ++level) maps_.emplace_back(round(level).cell_m);
    }
    bool empty() const { return maps_.front().empty(); }
    RegisterRound round(int level) const {
        return interpolate_rounds(first_, last_, level / double(kLevels - 1));
    }
    /// Adds points to the maps of all levels.
    /// @param travelled_m distance that the sensor had driven when it measured the points
    void add(const std::vector<glm::dvec3>& points_m, double travelled_m) {
        parallel_for(kLevels, [&](int level) {
            for (const glm::dvec3& point_m : points_m) maps_[std::size_t(level)].add(point_m, travelled_m);
        });
    }
    void remove_old_cells(double travelled_m) {
        for (VoxelPlanes& map : maps_) map.remove_old_cells(travelled_m);
    }
    /// Returns the plane at a point from map `level`, or from the next coarser map that
    /// has one. Distant points are sparse and form planes only in large cells. Returns
    /// null if no map has a plane.
    const Plane* find_finest_plane(const glm::dvec3& point_m, int level) const {
        const Plane* plane = nullptr;
        for (int l = level; l >= 0 && !plane; --l) plane = maps_[std::size_t(l)].at(point_m);
        return plane;
    }

private:
    RegisterRound first_, last_;
    std::vector<VoxelPlanes> maps_;  // [kLevels]
};

}  // namespace relidar
