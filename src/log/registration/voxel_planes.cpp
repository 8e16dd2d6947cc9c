// SPDX-License-Identifier: Apache-2.0
#include "log/registration/voxel_planes.hpp"

#include <array>
#include <cmath>
#include <mutex>

namespace relidar {
namespace {

constexpr double kFewestOfVoxel = 6;
// Points form a plane only if they spread over the cell. This is the minimum standard
// deviation along their narrower axis, divided by the cell size. A full cell has 0.29.
constexpr double kVoxelSpread = 0.12;
// maximum standard deviation of the points along the normal, divided by the cell size
constexpr double kThickness = 0.1;
/// Returns the mutex of a cell. 64 mutexes are enough for all cells, because threads
/// rarely fit planes at the same time.
std::mutex& get_mutex(const void* cell) {
    static std::array<std::mutex, 64> mutexes;
    return mutexes[reinterpret_cast<std::uintptr_t>(cell) / 64 % mutexes.size()];
}

}  // namespace

void VoxelPlanes::add(const glm::dvec3& point_m, double travelled_m) {
    Cell& cell = cells_[make_cell_key(point_m, cell_m_)];
    cell.sums.add(point_m - centre(point_m));
    cell.travelled_m = travelled_m;
}

const Plane* VoxelPlanes::at(const glm::dvec3& point_m) const {
    const auto found = cells_.find(make_cell_key(point_m, cell_m_));
    if (found == cells_.end() || found->second.sums.n < kFewestOfVoxel) return nullptr;
    const Cell& cell = found->second;
    if (cell.has_too_many_points()) {
        const std::scoped_lock lock(get_mutex(&cell));
        if (cell.has_too_many_points()) fit(cell, centre(point_m));
    }
    return cell.plane ? &*cell.plane : nullptr;
}

void VoxelPlanes::fit(const Cell& cell, const glm::dvec3& centre_m) const {
    const PlaneFit f = cell.sums.fit();
    const bool is_plane = f.variance[1] >= std::pow(kVoxelSpread * cell_m_, 2) &&
                          f.variance[0] <= std::pow(kThickness * cell_m_, 2);
    cell.plane.reset();
    if (is_plane) cell.plane = Plane{centre_m + f.mean, f.axes[0], f.axes[1], f.axes[2]};
    cell.n_fitted.store(cell.sums.n, std::memory_order_release);
}

void VoxelPlanes::remove_old_cells(double travelled_m) {
    std::erase_if(cells_, [&](const auto& entry) { return entry.second.travelled_m < travelled_m; });
}

}  // namespace relidar
