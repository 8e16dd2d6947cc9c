// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/classes.hpp>

#include <cmath>
#include <unordered_set>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/nearest_place.hpp"

namespace relidar {
namespace {

// Farther from the centre of the nearest cell, the class is unknown.
constexpr float kClassReach_m = 2.0f;

std::uint64_t key_of(const SurfaceClassCell& cell) { return grid_key(glm::dvec3(cell.grid_index), 1.0); }

}  // namespace

void merge_class_map(SurfaceClassMap& target_map, const SurfaceClassMap& source_map) {
    std::unordered_set<std::uint64_t> occupied_cells;
    for (const SurfaceClassCell& cell : target_map) occupied_cells.insert(key_of(cell));
    for (const SurfaceClassCell& cell : source_map)
        if (occupied_cells.insert(key_of(cell)).second) target_map.push_back(cell);
}

struct SurfaceClassLookup::Impl {
    NearestPointFinder<float> centres;
    std::vector<SurfaceClass> classes;
};

SurfaceClassLookup::SurfaceClassLookup(const SurfaceClassMap& map) {
    std::vector<glm::vec3> centres_m;
    std::vector<SurfaceClass> classes;
    for (const SurfaceClassCell& cell : map) {
        centres_m.emplace_back((glm::dvec3(cell.grid_index) + 0.5) * kClassCell_m);
        classes.push_back(cell.surface);
    }
    impl_.reset(new Impl{NearestPointFinder<float>(std::move(centres_m)), std::move(classes)});
}

SurfaceClassLookup::~SurfaceClassLookup() = default;

SurfaceClass SurfaceClassLookup::find_class(const glm::dvec3& point_m) const {
    const glm::vec3 point(point_m);
    if (!std::isfinite(point.x + point.y + point.z)) return SurfaceClass::unknown;
    const auto [cell, squared_m] = impl_->centres.nearest(point);
    return squared_m <= kClassReach_m * kClassReach_m ? impl_->classes[cell] : SurfaceClass::unknown;
}

}  // namespace relidar
