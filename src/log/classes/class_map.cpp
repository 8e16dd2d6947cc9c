// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/classes.hpp>

#include <cmath>
#include <unordered_set>

#include "base/cell_key.hpp"
#include "base/nearest_place.hpp"

namespace relidar {
namespace {

// Maximum distance between a point and the cell that defines its class.
constexpr float kClassReach_m = 2.0f;

std::uint64_t make_key(const ClassCell& cell) { return make_cell_key(glm::dvec3(cell.place), 1.0); }

std::vector<glm::vec3> compute_cell_centres(const ClassMap& map) {
    std::vector<glm::vec3> centres;
    for (const ClassCell& cell : map) centres.emplace_back((glm::dvec3(cell.place) + 0.5) * kClassCell_m);
    return centres;
}

}  // namespace

void add_classes(ClassMap& map, const ClassMap& other) {
    std::unordered_set<std::uint64_t> places;
    for (const ClassCell& cell : map) places.insert(make_key(cell));
    for (const ClassCell& cell : other)
        if (places.insert(make_key(cell)).second) map.push_back(cell);
}

struct ClassFinder::Impl {
    NearestPlace<float> centres;
    std::vector<SurfaceClass> classes;
};

ClassFinder::ClassFinder(const ClassMap& map)
    : impl_(new Impl{NearestPlace<float>(compute_cell_centres(map)), {}}) {
    for (const ClassCell& cell : map) impl_->classes.push_back(cell.surface);
}

ClassFinder::~ClassFinder() = default;

SurfaceClass ClassFinder::find(const glm::dvec3& point_m) const {
    const glm::vec3 point(point_m);
    if (!std::isfinite(point.x + point.y + point.z)) return SurfaceClass::unknown;
    const auto [cell, squared_m] = impl_->centres.find(point);
    return squared_m <= kClassReach_m * kClassReach_m ? impl_->classes[cell] : SurfaceClass::unknown;
}

}  // namespace relidar
