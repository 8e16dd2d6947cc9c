// SPDX-License-Identifier: Apache-2.0
// Computes the class map of a log, and finds the class of a point. Each labelled return
// gives one vote to the class of the world grid cell that contains it.
#include <relidar/log/classes.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_set>

#include <relidar/log/log.hpp>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/cell_numbers.hpp"
#include "base/geometry/nearest_place.hpp"
#include "base/joined.hpp"
#include "base/parallel.hpp"

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

namespace {

/// Returns the world grid cell and the class of each labelled return of a frame, except
/// in moving boxes, because the map is only of the background.
std::vector<SurfaceClassCell> collect_votes(const Log& log, const PoseTrack& world_from_sensor,
                                            const std::vector<BoxTrack>& moving_boxes, const Frame& frame) {
    const Scan& scan = frame.scan;
    std::vector<SurfaceClassCell> votes;
    for (std::size_t ray = 0; ray < scan.classes.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const WorldRay world =
            make_world_ray(world_from_sensor, frame.time_s, scan.rays, ray, log.rolling_shutter);
        const double range_m = surface_return(log, frame, ray).range_m;  // without the beam's offset
        const glm::dvec3 point_m = world.origin_m + range_m * world.direction;
        const double time_s =
            frame.time_s + (log.rolling_shutter ? double(scan.rays.time_offset_s[ray]) : 0.0);
        if (is_in_moving_box(moving_boxes, point_m, time_s, kMoverMargin_m)) continue;
        votes.push_back({glm::ivec3(glm::floor(point_m / kClassCell_m)), scan.classes[ray]});
    }
    return votes;
}

/// Gives each cell the class with most votes; in a tie, the one with the higher number.
SurfaceClassMap count_votes(const std::vector<SurfaceClassCell>& votes) {
    const ItemCellIndices cells =
        number_cells(votes.size(), [&](std::size_t vote) { return key_of(votes[vote]); });
    SurfaceClassMap map(cells.n_cells);
    std::vector<std::array<std::uint32_t, kSurfaceClasses>> counts(cells.n_cells);  // votes
    for (std::size_t vote = 0; vote < votes.size(); ++vote) {
        map[cells.of[vote]].grid_index = votes[vote].grid_index;
        ++counts[cells.of[vote]][std::size_t(votes[vote].surface)];
    }
    for (std::size_t cell = 0; cell < map.size(); ++cell) {
        // The first maximum from behind is the last one.
        const auto behind_most_voted = std::max_element(counts[cell].rbegin(), counts[cell].rend()).base();
        map[cell].surface = SurfaceClass(behind_most_voted - counts[cell].begin() - 1);
    }
    return map;
}

}  // namespace

SurfaceClassMap map_classes(const Log& log, const PoseTrack& world_from_vehicle,
                            const std::vector<BoxTrack>& boxes, const std::vector<int>& frame_indices) {
    std::vector<PoseTrack> world_from_sensor;
    for (const Lidar& lidar : log.lidars)
        world_from_sensor.push_back(mount_track(world_from_vehicle, lidar.vehicle_from_sensor));
    std::vector<BoxTrack> moving_boxes = boxes;
    std::erase_if(moving_boxes, [](const BoxTrack& box) { return !box.is_moving(); });

    std::vector<std::vector<SurfaceClassCell>> votes_of_frame(frame_indices.size());
    parallel_for(int(frame_indices.size()), [&](int index) {
        const Frame& frame = log.frames[std::size_t(frame_indices[std::size_t(index)])];
        votes_of_frame[std::size_t(index)] =
            collect_votes(log, world_from_sensor[std::size_t(frame.lidar)], moving_boxes, frame);
    });
    return count_votes(concatenate(std::move(votes_of_frame)));
}

}  // namespace relidar
