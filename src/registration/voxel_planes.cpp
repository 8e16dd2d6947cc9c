// SPDX-License-Identifier: Apache-2.0
#include "registration/voxel_planes.hpp"

#include <cmath>

namespace relidar {
namespace {

constexpr double kFewestOfVoxel = 6;
constexpr double kVoxelSpread = 0.12;  // of the cell's edge: least standard deviation along the narrower axis; 0.29 fills the cell
constexpr double kThickness = 0.1;    // of the cell's edge: largest standard deviation along the normal
constexpr double kRefit = 1.1;        // growth after which a plane is fitted anew

}  // namespace

void VoxelPlanes::add(const glm::dvec3& point_m, double travelled_m) {
    Cell& cell = cells_[cell_key(point_m, cell_m_)];
    cell.sums.add(point_m - centre(point_m));
    cell.travelled_m = travelled_m;
}

const Plane* VoxelPlanes::at(const glm::dvec3& point_m) const {
    const auto found = cells_.find(cell_key(point_m, cell_m_));
    if (found == cells_.end() || found->second.sums.n < kFewestOfVoxel) return nullptr;
    const Cell& cell = found->second;
    if (cell.sums.n >= kRefit * cell.n_fitted) fit(cell, centre(point_m));
    return cell.plane ? &*cell.plane : nullptr;
}

void VoxelPlanes::fit(const Cell& cell, const glm::dvec3& centre_m) const {
    const PlaneFit f = cell.sums.fit();
    cell.n_fitted = cell.sums.n;
    cell.plane.reset();
    if (f.variance[1] < std::pow(kVoxelSpread * cell_m_, 2) || f.variance[0] > std::pow(kThickness * cell_m_, 2)) return;
    cell.plane = Plane{centre_m + f.mean, f.axes[0], f.axes[1], f.axes[2]};
}

void VoxelPlanes::forget(double travelled_m) {
    std::erase_if(cells_, [&](const auto& entry) { return entry.second.travelled_m < travelled_m; });
}

}  // namespace relidar
