// SPDX-License-Identifier: Apache-2.0
// Visibility of points in the frames of a log, by range images.
#include "scene/visibility.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/cell_key.hpp"
#include "core/parallel.hpp"

namespace relidar {

namespace {

constexpr int kRows = 64, kColumns = 1024;
constexpr int kMinReturns = 3;         // of the 3 x 3 pixels around a point
constexpr int kSectors = 64;           // of a sweep: in one the sensor moves by millimetres to centimetres
constexpr double kTile_m = 8.0;        // of the ground, whose points ask the same frames
constexpr double kNear_m = 40.0;       // a sensor farther away sees a person as a return or two, and most places not at all
constexpr double kHardlyFarther = 1.25;   // than the nearest sensor, where none is near
constexpr std::size_t kMostViews = 64;

/// A grid over a LiDAR's vertical field of view: a beam or so a row, and as fine as any where it has no beams. @param scan  one of its own
RangeGrid grid_over(const SpinningSensor& sensor, const Scan& scan) {
    double low = 1e9, high = -1e9;
    const auto add = [&](double elevation_rad) { low = std::min(low, elevation_rad), high = std::max(high, elevation_rad); };
    for (const Beam& beam : sensor.beams) add(beam.elevation_rad);
    if (sensor.beams.empty())
        for (const glm::vec3& d : scan.rays.direction) add(std::asin(std::clamp(double(d.z), -1.0, 1.0)));
    const double margin = 0.02;
    const int rows = sensor.beams.empty() ? kRows : std::min(kRows, static_cast<int>(sensor.beams.size()));
    return {"visibility", rows, kColumns, high + margin, high - low + 2.0 * margin, 1e6};
}

glm::dvec3 tile_centre(const glm::dvec3& p) {
    return kTile_m * (glm::floor(glm::dvec3(p.x, p.y, 0.0) / kTile_m) + glm::dvec3(0.5, 0.5, 0.0));
}

/// Every so many-th of them, so that at most kMostViews are left.
void thin_out(std::vector<std::uint32_t>& views) {
    if (views.size() <= kMostViews) return;
    std::vector<std::uint32_t> kept;
    for (std::size_t k = 0; k < kMostViews; ++k) kept.push_back(views[k * views.size() / kMostViews]);
    views = std::move(kept);
}

}  // namespace

Visibility::Visibility(const Sequence& sequence, const std::vector<int>& positions)
    : sequence_(sequence), positions_(positions) {
    grids_.resize(sequence.lidars.size());   // those of LiDARs without a view are not asked
    std::vector<char> has_grid(grids_.size());
    for (const int position : positions) {
        const Frame& frame = sequence.frames[std::size_t(position)];
        const std::size_t lidar = std::size_t(frame.lidar);
        if (!std::exchange(has_grid[lidar], 1)) grids_[lidar] = grid_over(sequence.lidars[lidar].sensor, frame.scan);
        views_.push_back({frame.time_s, frame.lidar, {}, {}});
    }
    sort_by_tile();
}

void Visibility::want(const glm::dvec3& point_m) {
    const auto tile = tiles_.find(cell_key(tile_centre(point_m), kTile_m));
    if (tile == tiles_.end() || std::exchange(tile->second.wanted, true)) return;
    for (const std::uint32_t view : tile->second.views)
        if (views_[view].sensor_from_world.empty()) wanted_.push_back(view);
}

void Visibility::make_wanted() {
    std::sort(wanted_.begin(), wanted_.end());
    wanted_.erase(std::unique(wanted_.begin(), wanted_.end()), wanted_.end());
    run_parallel(static_cast<int>(wanted_.size()), [&](int i) {
        const std::uint32_t view = wanted_[std::size_t(i)];
        make(views_[view], sequence_.frames[std::size_t(positions_[view])]);
    });
    wanted_.clear();
}

void Visibility::make(View& view, const Frame& frame) const {
    const Pose& mounted = sequence_.lidar_of(frame).vehicle_from_sensor;
    const int n_sectors = sequence_.rolling_shutter ? kSectors : 1;
    for (int sector = 0; sector < n_sectors; ++sector) {
        const double azimuth = 2.0 * kPi * ((sector + 0.5) / n_sectors - 0.5);
        view.sensor_from_world.push_back(inverse(sequence_.world_from_vehicle.at(
            facing_time(sequence_, {std::cos(azimuth), std::sin(azimuth), 0.0}, moment_of(frame)), mounted)));
    }
    std::vector<glm::vec3> points;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
        if (frame.scan.range_m[ray] > 0.0f) points.push_back(frame.scan.point(ray));
    view.range_m = project_points(grids_[std::size_t(frame.lidar)], points, std::vector<float>(points.size(), 0.0f)).range_m;
}

void Visibility::sort_by_tile() {
    struct Seen {
        std::uint32_t view;
        double distance_m;
    };
    std::unordered_map<std::uint64_t, std::vector<Seen>> all;
    for (std::uint32_t v = 0; v < views_.size(); ++v) {
        const Lidar& lidar = sequence_.lidars[std::size_t(views_[v].lidar)];
        const double farthest = lidar.sensor.max_range_m + kTile_m;
        glm::dvec3 sensor = sequence_.world_from_vehicle.at(views_[v].time_s, lidar.vehicle_from_sensor).translation;
        sensor.z = 0.0;
        for (double dx = -farthest; dx <= farthest; dx += kTile_m)
            for (double dy = -farthest; dy <= farthest; dy += kTile_m) {
                const glm::dvec3 tile = tile_centre(sensor + glm::dvec3(dx, dy, 0.0));
                if (const double distance = glm::distance(tile, sensor); distance < farthest)
                    all[cell_key(tile, kTile_m)].push_back({v, distance});
            }
    }
    for (const auto& [key, seen] : all) {
        const double nearest = std::min_element(seen.begin(), seen.end(), [](const Seen& a, const Seen& b) {
                                   return a.distance_m < b.distance_m;
                               })->distance_m;
        std::vector<std::uint32_t>& views = tiles_[key].views;
        for (const Seen& s : seen)
            if (s.distance_m <= std::max(kNear_m, kHardlyFarther * nearest)) views.push_back(s.view);
        thin_out(views);
    }
}

const std::vector<std::uint32_t>& Visibility::views_near(const glm::dvec3& point_m) const {
    static const std::vector<std::uint32_t> none;
    const auto tile = tiles_.find(cell_key(tile_centre(point_m), kTile_m));
    return tile == tiles_.end() ? none : tile->second.views;
}

Visibility::Surroundings Visibility::around(const View& view, const glm::dvec3& point_m) const {
    const int n_sectors = static_cast<int>(view.sensor_from_world.size());
    const glm::dvec3 roughly = view.sensor_from_world[std::size_t(n_sectors / 2)] * point_m;
    const int sector = static_cast<int>((0.5 + std::atan2(roughly.y, roughly.x) / (2.0 * kPi)) * n_sectors);
    const glm::dvec3 p = view.sensor_from_world[std::size_t(std::clamp(sector, 0, n_sectors - 1))] * point_m;
    Surroundings result;
    const RangeGrid& grid = grids_[std::size_t(view.lidar)];
    const std::optional<int> pixel = project(grid, p);
    if (!pixel) return result;
    result.range_m = glm::length(p);
    const int row = *pixel / grid.columns, column = *pixel % grid.columns;
    for (int r = std::max(row - 1, 0); r <= std::min(row + 1, grid.rows - 1); ++r)
        for (int c = column - 1; c <= column + 1; ++c)
            if (const float value = view.range_m[std::size_t(r * grid.columns + (c + grid.columns) % grid.columns)]; value > 0.0f)
                result.returned_m[result.n++] = value;
    return result;
}

Sight Visibility::look(std::uint32_t view, const glm::dvec3& point_m) const {
    const Surroundings here = around(views_[view], point_m);
    if (here.n < kMinReturns) return Sight::nothing;
    const auto [nearest, farthest] = std::minmax_element(here.returned_m, here.returned_m + here.n);
    const double range = here.range_m, margin = 0.3 + 0.02 * range;
    if (*nearest > range + 2.0 * margin) return Sight::seen_through;
    return range > *nearest - margin && range < *farthest + margin ? Sight::seen : Sight::nothing;
}

bool Visibility::has_return_at(std::uint32_t view, const glm::dvec3& point_m, double tolerance_m) const {
    const Surroundings here = around(views_[view], point_m);
    return std::any_of(here.returned_m, here.returned_m + here.n,
                       [&](float returned) { return std::abs(returned - here.range_m) < tolerance_m; });
}

Visibility::Votes Visibility::votes(const glm::vec3& point_m) const {
    Votes votes;
    for (const std::uint32_t view : views_near(glm::dvec3(point_m))) {
        const Sight sight = look(view, glm::dvec3(point_m));
        votes.seen += sight == Sight::seen;
        votes.seen_through += sight == Sight::seen_through;
    }
    return votes;
}

}  // namespace relidar
