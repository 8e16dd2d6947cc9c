// SPDX-License-Identifier: Apache-2.0
// Stores maps of planes with several cell sizes, so that scans can be aligned from coarse
// to fine.
#pragma once

#include <vector>

#include "base/parallel.hpp"
#include "registration/voxel_planes.hpp"

namespace relidar {

class PlaneMaps {
public:
    static constexpr int kLevels = 3;

    /// @param first, last  cell size and scale of the robust kernel at the coarsest and
    /// at the finest level
    PlaneMaps(const FitRound& first, const FitRound& last) : first_(first), last_(last) { clear(); }

    void clear() {
        maps_.clear();
        for (int level = 0; level < kLevels; ++level) maps_.emplace_back(settings_of_level(level).cell_m);
    }
    bool empty() const { return maps_.front().empty(); }
    FitRound settings_of_level(int level) const {
        return blend_rounds(first_, last_, level / double(kLevels - 1));
    }
    /// Adds points that the vehicle measured after driving `travelled_distance_m`.
    void add_points(const std::vector<glm::dvec3>& points_m, double travelled_distance_m) {
        parallel_for(kLevels, [&](int level) {
            for (const glm::dvec3& point_m : points_m)
                maps_[std::size_t(level)].add_point(point_m, travelled_distance_m);
        });
    }
    void forget_before(double min_travelled_distance_m) {
        for (VoxelPlaneMap& map : maps_) map.remove_before(min_travelled_distance_m);
    }
    /// Returns the plane at a point. Searches map `finest_level` first, then the coarser
    /// maps, because distant points form planes only in large cells. Returns null if no
    /// map has a plane.
    const LocalPlane* find_plane(const glm::dvec3& point_m, int finest_level) const {
        const LocalPlane* plane = nullptr;
        for (int l = finest_level; l >= 0 && !plane; --l)
            plane = maps_[std::size_t(l)].find_plane_at(point_m);
        return plane;
    }

private:
    FitRound first_, last_;
    std::vector<VoxelPlaneMap> maps_;  // [kLevels]
};

}  // namespace relidar
