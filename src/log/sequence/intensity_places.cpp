// SPDX-License-Identifier: Apache-2.0
#include "log/sequence/intensity_places.hpp"

#include <algorithm>
#include <cmath>

#include "base/cell_key.hpp"
#include "base/cell_numbers.hpp"
#include "base/joined.hpp"
#include "base/plane_sums.hpp"
#include "log/sequence/beam_returns.hpp"

namespace relidar {
namespace {

// Intensities are compared within small cells ("places") of this size. A place contains
// only one surface, but is hit several times.
constexpr double kPlace_m = 0.1;
// The surface normals at the places are those of planes, which are fitted in larger cells
// of this size.
constexpr double kSurface_m = 0.4;
constexpr double kMinPoints = 8.0;
// Points form a plane if they are thin: their standard deviation along the normal must be
// less than this fraction of the smaller standard deviation within the plane.
constexpr double kMaxThickness = 0.15;
constexpr std::size_t kMostCompared = 6000000;

struct SeenPlace {
    glm::dvec3 point_m{0.0};
    glm::vec3 direction{0.0f};
    PlaceReturn given;  ///< the return; `place` and `cosine` are computed later
};

std::vector<SeenPlace> collect_observed_places(const Sequence& sequence, const Frame& frame) {
    std::vector<SeenPlace> result;
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        const auto beam =
            find_beam_of_return(sequence, frame, ray, sequence.get_lidar(frame).sensor.max_range_m);
        if (!beam) continue;
        const WorldReturn w = compute_world_return(sequence, frame, ray);
        result.push_back(
            {w.point_m,
             glm::vec3(w.direction),
             {0, *beam, compute_surface_return(sequence, frame, ray).range_m, 0.0f, scan.intensity[ray]}});
    }
    return result;
}

/// Numbers the cells of a world grid that contain returns.
/// @param places returns of all frames
/// @param cell_m edge length of a cell
CellNumbers cells_of(const std::vector<SeenPlace>& places, double cell_m) {
    return assign_cell_numbers(
        places.size(), [&](std::size_t index) { return make_cell_key(places[index].point_m, cell_m); });
}

/// Computes the surface normal in each cell of size kSurface_m, or zero if the returns of
/// the cell do not lie on a plane.
std::vector<glm::vec3> estimate_normals_of_places(const std::vector<SeenPlace>& places,
                                                  const CellNumbers& cells) {
    const ItemsOfCells items(cells);
    std::vector<glm::vec3> normals(cells.n_cells, glm::vec3(0.0f));
    for_each_block(cells.n_cells, [&](std::size_t cell) {
        if (double(items.of(cell).size()) < kMinPoints) return;
        PlaneSums sums;
        for (const std::uint32_t i : items.of(cell))
            sums.add(places[i].point_m - kSurface_m * glm::floor(places[i].point_m / kSurface_m));
        const PlaneFit fit = sums.fit();
        if (fit.variance[0] <= kMaxThickness * kMaxThickness * fit.variance[1])
            normals[cell] = glm::vec3(fit.axes[0]);
    });
    return normals;
}

}  // namespace

PlaceReturns collect_place_returns(const Sequence& sequence, const std::vector<int>& positions) {
    std::vector<SeenPlace> seen =
        concatenate(read_frames(sequence, positions, kMostCompared, [&](const Frame& frame) {
            return collect_observed_places(sequence, frame);
        }));
    {
        const CellNumbers cells = cells_of(seen, kSurface_m);
        const std::vector<glm::vec3> normals = estimate_normals_of_places(seen, cells);
        for_each_block(seen.size(), [&](std::size_t index) {
            seen[index].given.cosine = std::abs(glm::dot(normals[cells.of[index]], seen[index].direction));
        });
        std::size_t n = 0;
        for (std::size_t i = 0; i < seen.size(); ++i)
            if (normals[cells.of[i]] != glm::vec3(0.0f)) seen[n++] = seen[i];
        seen.resize(n);
    }
    const CellNumbers places = cells_of(seen, kPlace_m);
    const ItemsOfCells items(places);
    std::vector<PlaceReturn> by_place;  // sorted by place; places with a single return are left out
    for (std::uint32_t place = 0; place < places.n_cells; ++place) {
        if (items.of(place).size() < 2) continue;
        for (const std::uint32_t i : items.of(place)) {
            by_place.push_back(seen[i].given);
            by_place.back().place = place;
        }
    }
    return {std::move(by_place), places.n_cells};
}

}  // namespace relidar
