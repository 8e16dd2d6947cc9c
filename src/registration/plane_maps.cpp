// SPDX-License-Identifier: Apache-2.0
#include "registration/plane_maps.hpp"

#include <array>
#include <cmath>
#include <mutex>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr double kFewestOfVoxel = 6;
// Points form a plane only if they cover enough of their cell. Minimum standard deviation
// along the narrower direction of the plane, divided by the cell size.
constexpr double kVoxelSpread = 0.12;
constexpr double kMaxThicknessPerCell = 0.1;  // maximum standard deviation along the normal / cell size

/// Returns the mutex that is locked while a plane is fitted to the points of a cell. All
/// cells share 64 mutexes, because fits rarely run at the same time.
std::mutex& cell_mutex(const void* cell_address) {
    static std::array<std::mutex, 64> mutexes;
    return mutexes[reinterpret_cast<std::uintptr_t>(cell_address) / 64 % mutexes.size()];
}

}  // namespace

void VoxelPlaneMap::add_point(const glm::dvec3& point_m, double travelled_distance_m) {
    VoxelPlaneCell& cell = cells_[grid_key(point_m, cell_m_)];
    cell.sums.add_point(point_m - cell_centre(point_m));
    cell.travelled_m = travelled_distance_m;
}

const LocalPlane* VoxelPlaneMap::find_plane_at(const glm::dvec3& point_m) const {
    const auto cell_entry = cells_.find(grid_key(point_m, cell_m_));
    if (cell_entry == cells_.end() || cell_entry->second.sums.n < kFewestOfVoxel) return nullptr;
    const VoxelPlaneCell& cell = cell_entry->second;
    // Planes are fitted when they are first needed after the cell has grown.
    if (cell.is_outdated()) {
        const std::scoped_lock lock(cell_mutex(&cell));
        // Another thread may have fitted the plane while this thread waited for the lock.
        if (cell.is_outdated()) refit_plane(cell, cell_centre(point_m));
    }
    return cell.plane ? &*cell.plane : nullptr;
}

void VoxelPlaneMap::refit_plane(const VoxelPlaneCell& cell, const glm::dvec3& cell_centre_m) const {
    const PlaneFit f = cell.sums.fit_plane();
    const bool is_plane = f.variance[1] >= std::pow(kVoxelSpread * cell_m_, 2) &&
                          f.variance[0] <= std::pow(kMaxThicknessPerCell * cell_m_, 2);
    cell.plane.reset();
    if (is_plane) {
        cell.plane = LocalPlane{cell_centre_m + f.mean, f.axes[0], f.axes[1], f.axes[2]};
        cell.plane->set_tilts(cell.sums.n, f.variance[0], f.variance[1], f.variance[2]);
    }
    cell.n_fitted.store(cell.sums.n, std::memory_order_release);
}

void VoxelPlaneMap::remove_before(double min_travelled_distance_m) {
    std::erase_if(cells_,
                  [&](const auto& entry) { return entry.second.travelled_m < min_travelled_distance_m; });
}

void PlaneMaps::clear() {
    maps_.clear();
    for (int level = 0; level < kLevels; ++level) maps_.emplace_back(settings_of_level(level).cell_m);
}

void PlaneMaps::add_points(const std::vector<glm::dvec3>& points_m, double travelled_distance_m) {
    parallel_for(kLevels, [&](int level) {
        for (const glm::dvec3& point_m : points_m)
            maps_[std::size_t(level)].add_point(point_m, travelled_distance_m);
    });
}

void PlaneMaps::forget_before(double min_travelled_distance_m) {
    for (VoxelPlaneMap& map : maps_) map.remove_before(min_travelled_distance_m);
}

const LocalPlane* PlaneMaps::find_plane(const glm::dvec3& point_m, int finest_level) const {
    const LocalPlane* plane = nullptr;
    for (int l = finest_level; l >= 0 && !plane; --l) plane = maps_[std::size_t(l)].find_plane_at(point_m);
    return plane;
}

}  // namespace relidar
