// SPDX-License-Identifier: Apache-2.0
#include "log/calibration/beam_returns.hpp"

#include <algorithm>
#include <cmath>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/cell_numbers.hpp"
#include "base/geometry/plane_sums.hpp"
#include "base/joined.hpp"

namespace relidar {
namespace {

// Edge length of the grid cells in which intensities are compared. A cell is so small
// that it contains one surface, but large enough to be hit several times.
constexpr double kIntensityCell_m = 0.1;
// Size of the grid cells in which planes are fitted. The normal of the plane gives the
// angle of incidence of all returns in the cell.
constexpr double kNormalCell_m = 0.4;
constexpr double kMinPoints = 8.0;
// Points form a plane only if their standard deviation along the normal is small. The
// limit is this fraction of the smaller standard deviation within the plane.
constexpr double kMaxThickness = 0.15;
constexpr std::size_t kMostCompared = 6000000;

struct ReturnPoint {
    glm::dvec3 point_m{0.0};
    glm::vec3 direction{0.0f};
    CellReturn cell_return;
};

/// Lists the returns of a frame. Points (in the world) and ranges are without the range
/// offsets of beams. compute_cosines() and collect_cells() set their cosines and cells.
std::vector<ReturnPoint> collect_returns(const Log& log, const Frame& frame) {
    std::vector<ReturnPoint> result;
    const double max_range_m = log.lidar_of(frame).sensor.max_range_m;
    visit_returns(log, frame, max_range_m,
                  [&](std::size_t ray, std::uint16_t beam, const WorldReturn& in_world) {
                      result.push_back({.point_m = in_world.point_m,
                                        .direction = glm::vec3(in_world.direction),
                                        .cell_return = {.beam = beam,
                                                        .range_m = surface_return(log, frame, ray).range_m,
                                                        .intensity = frame.scan.intensity[ray]}});
                  });
    return result;
}

/// Numbers the cells of a world grid that contain returns.
ItemCellIndices cells_of_returns(const std::vector<ReturnPoint>& returns, double cell_size_m) {
    return number_cells(returns.size(),
                        [&](std::size_t index) { return grid_key(returns[index].point_m, cell_size_m); });
}

/// Computes the surface normal in each cell. The normal has length zero if the returns in
/// the cell do not form a plane.
std::vector<glm::vec3> estimate_normals(const std::vector<ReturnPoint>& returns,
                                        const ItemCellIndices& cells) {
    const CellItemLists items(cells);
    std::vector<glm::vec3> normals(cells.n_cells, glm::vec3(0.0f));
    parallel_blocks(cells.n_cells, [&](std::size_t cell) {
        if (double(items.items_of(cell).size()) < kMinPoints) return;
        PointMomentSums sums;
        // Coordinates relative to the cell keep the precision of their squares.
        for (const std::uint32_t i : items.items_of(cell)) {
            const glm::dvec3& point_m = returns[i].point_m;
            sums.add_point(point_m - kNormalCell_m * glm::floor(point_m / kNormalCell_m));
        }
        const PlaneFit fit = sums.fit_plane();
        // Axis 0 has the least variance. It is the normal of the plane.
        if (fit.variance[0] <= kMaxThickness * kMaxThickness * fit.variance[1])
            normals[cell] = glm::vec3(fit.axes[0]);
    });
    return normals;
}

/// Computes the cosine of incidence of each return. Drops returns that are not on a
/// plane, because their angle of incidence is unknown.
void compute_cosines(std::vector<ReturnPoint>& returns) {
    const ItemCellIndices cells = cells_of_returns(returns, kNormalCell_m);
    const std::vector<glm::vec3> normals = estimate_normals(returns, cells);
    constexpr float kUnknownCosine = -1.0f;
    parallel_blocks(returns.size(), [&](std::size_t index) {
        const glm::vec3& normal = normals[cells.of[index]];
        const bool is_on_plane = normal != glm::vec3(0.0f);
        returns[index].cell_return.cosine =
            is_on_plane ? std::abs(glm::dot(normal, returns[index].direction)) : kUnknownCosine;
    });
    std::erase_if(returns, [](const ReturnPoint& r) { return r.cell_return.cosine == kUnknownCosine; });
}

}  // namespace

CellReturns collect_cells(const Log& log, const std::vector<int>& frames) {
    std::vector<ReturnPoint> returns = concatenate(map_frames(
        log, frames, kMostCompared, [&](const Frame& frame) { return collect_returns(log, frame); }));
    compute_cosines(returns);  // also drops returns
    const ItemCellIndices cell_numbers = cells_of_returns(returns, kIntensityCell_m);
    const CellItemLists items(cell_numbers);
    std::vector<CellReturn> returns_by_cell;
    for (std::uint32_t cell = 0; cell < cell_numbers.n_cells; ++cell) {
        if (items.items_of(cell).size() < 2) continue;  // nothing to compare with
        for (const std::uint32_t i : items.items_of(cell)) {
            returns_by_cell.push_back(returns[i].cell_return);
            returns_by_cell.back().cell = cell;
        }
    }
    return {std::move(returns_by_cell), cell_numbers.n_cells};
}

}  // namespace relidar
