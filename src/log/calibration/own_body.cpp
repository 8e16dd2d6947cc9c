// SPDX-License-Identifier: Apache-2.0
// Finds the body that carries a LiDAR in three steps:
// 1. Directions with a short range that is the same at all places of the sensor.
// 2. Of these, directions whose points rays from other places pass through.
// 3. Directions without rays get the result of their nearest neighbour.
#include <relidar/log/own_body.hpp>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstdint>
#include <map>

#include <fmt/format.h>

#include "base/geometry/circular_gap.hpp"
#include "base/median.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

// A body reaches at most this far. The front of a car is 4 m from a sensor above its rear
// axle. Another vehicle that drives ahead is farther away.
constexpr float kReach_m = 4.0f;
// Places of the sensor that are compared.
constexpr double kPlaceStep_m = 0.2;
constexpr std::size_t kMinPlaces = 5, kMostPlaces = 24;
constexpr double kMinBodyShare = 0.001;  // of the returns
// A direction shows a constant range if it has this share of returns among its rays, and
// this share of constant ranges among its returns.
constexpr double kMinReturnedShare = 0.3, kMinConstantShare = 0.9;
// Points of the body are tested with rays from places at about these distances, at least
// kMinRanges times the range of the point. From nearer places, another part of the body
// can be at the position of the point.
constexpr std::array kWitness_m = {1.0, 1.5, 2.0, 4.0, 8.0, 16.0};
constexpr double kMinRanges = 2.5, kMaxView_m = 20.0;
// A ray passes through a point if it is near the point and ends this much farther away. A
// ray that just misses flat ground ends at the ground soon after the point.
constexpr double kMinBehind = 1.5, kMinBehind_m = 0.5;
constexpr std::size_t kMostVoters = 30000;
constexpr std::uint32_t kMinVotes = 5;
constexpr double kMinThroughShare = 0.7;
constexpr int kVoteWindow = 4;  // cells on each side whose votes count together
constexpr int kFillColumns = 2, kFillRows = 6;
constexpr std::size_t kMinBodyCells = 20;  // 5 square degrees

/// Returns how far ranges of the same part of the body can be apart: noise, vibrations,
/// and the extent of a cell on an oblique surface.
float body_tolerance_m(float range_m) { return 0.05f + 0.05f * range_m; }

std::size_t wrapped_cell(int row, int column) {
    constexpr int n = BodyTable::kColumns;
    return std::size_t(row) * std::size_t(n) + std::size_t((column + n) % n);
}

/// Calls visit(cell) for the cells around a cell, and for the cell itself.
template <class Visit>
void visit_window(std::size_t cell, int n_around, const Visit& visit) {
    const int row = int(cell) / BodyTable::kColumns, column = int(cell) % BodyTable::kColumns;
    for (int r = std::max(row - n_around, 0); r <= std::min(row + n_around, BodyTable::kRows - 1); ++r)
        for (int c = column - n_around; c <= column + n_around; ++c) visit(wrapped_cell(r, c));
}

/// A sweep, and where the sensor was.
struct SensorPlace {
    const Frame* frame;
    glm::dvec3 position_m;
};

std::vector<SensorPlace> list_places(const Log& log, int lidar, const std::vector<int>& frames) {
    std::vector<SensorPlace> places;
    for (const int index : frames) {
        const Frame& frame = log.frames[std::size_t(index)];
        if (frame.lidar != lidar || frame.scan.range_m.empty()) continue;
        const glm::dvec3 position_m =
            log.world_from_vehicle.mounted_pose_at(frame.time_s, log.lidar_of(frame).vehicle_from_sensor)
                .translation;
        if (places.empty() || glm::distance(position_m, places.back().position_m) >= kPlaceStep_m)
            places.push_back({&frame, position_m});
    }
    return places;
}

/// Returns the indices of some places, evenly.
std::vector<std::size_t> choose_places(std::size_t n_places) {
    const std::size_t n = std::min(n_places, kMostPlaces);
    std::vector<std::size_t> chosen;
    for (std::size_t i = 0; i < n; ++i) chosen.push_back(i * n_places / n);
    return chosen;
}

struct NearReturn {
    std::uint32_t cell, place, ray;  ///< place: index into the list of all places
    float range_m;
};

/// Numbers of rays and returns in each cell, and all returns within kReach_m by cell.
struct ReturnsByCell {
    std::vector<std::uint32_t> n_rays = std::vector<std::uint32_t>(BodyTable::kCells),
                               n_returns = std::vector<std::uint32_t>(BodyTable::kCells);
    std::vector<NearReturn> near;
    std::size_t n_all_returns = 0;
};

bool has_near_returns(const std::vector<SensorPlace>& places, const std::vector<std::size_t>& chosen) {
    std::size_t n_near = 0, n_returns = 0;
    for (const std::size_t place : chosen)
        for (const float range_m : places[place].frame->scan.range_m) {
            n_returns += range_m > 0.0f;
            n_near += range_m > 0.0f && range_m <= kReach_m;
        }
    return double(n_near) >= kMinBodyShare * double(n_returns);
}

ReturnsByCell collect_returns(const std::vector<SensorPlace>& places,
                              const std::vector<std::size_t>& chosen) {
    ReturnsByCell result;
    std::vector<std::vector<NearReturn>> near_of(chosen.size());
    parallel_for(int(chosen.size()), [&](int i) {
        const std::size_t place = chosen[std::size_t(i)];
        const Scan& scan = places[place].frame->scan;
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
            const std::size_t cell = BodyTable::cell_of(scan.rays.direction[ray]);
            const float range_m = scan.range_m[ray];
            std::atomic_ref(result.n_rays[cell]).fetch_add(1, std::memory_order_relaxed);
            if (!(range_m > 0.0f)) continue;
            std::atomic_ref(result.n_returns[cell]).fetch_add(1, std::memory_order_relaxed);
            if (range_m <= kReach_m)
                near_of[std::size_t(i)].push_back(
                    {std::uint32_t(cell), std::uint32_t(place), std::uint32_t(ray), range_m});
        }
    });
    for (const std::vector<NearReturn>& near : near_of)
        result.near.insert(result.near.end(), near.begin(), near.end());
    std::ranges::stable_sort(result.near, {}, &NearReturn::cell);
    for (const std::uint32_t n : result.n_returns) result.n_all_returns += n;
    return result;
}

/// Sets the range and intensity of a cell if its returns have the same range.
/// @param near  all near returns in the cell
/// @return the returns with this range; none if the cell has other returns
std::vector<NearReturn> measure_cell(BodyTable& table, const ReturnsByCell& returns,
                                     std::span<const NearReturn> near,
                                     const std::vector<SensorPlace>& places) {
    std::vector<float> ranges_m, intensities;
    for (const NearReturn& hit : near) ranges_m.push_back(hit.range_m);
    const float range_m = compute_median(ranges_m);
    std::vector<NearReturn> constant;
    for (const NearReturn& hit : near) {
        if (std::abs(hit.range_m - range_m) > body_tolerance_m(range_m)) continue;
        constant.push_back(hit);
        intensities.push_back(places[hit.place].frame->scan.intensity[hit.ray]);
    }
    const std::size_t cell = near.front().cell;
    const double n_returns = returns.n_returns[cell], n_rays = returns.n_rays[cell];
    if (double(constant.size()) < kMinConstantShare * n_returns || n_returns < kMinReturnedShare * n_rays)
        return {};
    table.range_m[cell] = range_m;
    table.intensity[cell] = n_returns < 0.5 * n_rays ? BodyTable::kNoReturn : compute_median(intensities);
    return constant;
}

/// Removes the cells that show their range from fewer than kMinPlaces places. Counts the
/// returns of neighbouring cells, too, because a beam can alternate between two cells.
void remove_rare(BodyTable& table, const std::vector<NearReturn>& constant,
                 const std::vector<std::size_t>& chosen) {
    std::vector<std::uint32_t> seen_from(BodyTable::kCells);  // a bit for each chosen place
    static_assert(kMostPlaces <= 32);
    for (const NearReturn& hit : constant)
        seen_from[hit.cell] |= 1u << (std::ranges::lower_bound(chosen, hit.place) - chosen.begin());
    std::vector<std::size_t> rare;
    for (std::size_t cell = 0; cell < BodyTable::kCells; ++cell) {
        const float range_m = table.range_m[cell];
        std::uint32_t seen_nearby = 0;
        if (range_m > 0.0f)
            visit_window(cell, 1, [&](std::size_t near) {
                if (std::abs(table.range_m[near] - range_m) <= body_tolerance_m(range_m))
                    seen_nearby |= seen_from[near];
            });
        if (std::size_t(std::popcount(seen_nearby)) < kMinPlaces) rare.push_back(cell);
    }
    for (const std::size_t cell : rare) table.range_m[cell] = 0.0f;
}

/// Sets all cells with a constant near range. Returns their returns.
std::vector<NearReturn> find_constant(BodyTable& table, const ReturnsByCell& returns,
                                      const std::vector<SensorPlace>& places,
                                      const std::vector<std::size_t>& chosen) {
    table.range_m.assign(BodyTable::kCells, 0.0f);
    table.intensity.assign(BodyTable::kCells, 0.0f);
    std::vector<NearReturn> all;
    const std::span<const NearReturn> near = returns.near;
    for (std::size_t begin = 0, end = 0; begin < near.size(); begin = end) {
        while (end < near.size() && near[end].cell == near[begin].cell) ++end;
        const auto constant = measure_cell(table, returns, near.subspan(begin, end - begin), places);
        all.insert(all.end(), constant.begin(), constant.end());
    }
    remove_rare(table, all, chosen);
    std::erase_if(all, [&](const NearReturn& hit) { return !(table.range_m[hit.cell] > 0.0f); });
    return all;
}

/// The returned rays of a sweep by direction, in cells of one degree.
class RaysByDirection {
public:
    explicit RaysByDirection(const Scan& scan) : first_(kCells + 1) {
        std::vector<std::uint32_t> cell_of_ray(scan.range_m.size(), kCells);
        for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray)
            if (scan.range_m[ray] > 0.0f) {
                cell_of_ray[ray] = find_cell(scan.rays.direction[ray]);
                ++first_[cell_of_ray[ray] + 1];
            }
        for (std::size_t cell = 0; cell < kCells; ++cell) first_[cell + 1] += first_[cell];
        rays_.resize(first_[kCells]);
        std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
        for (std::uint32_t ray = 0; ray < cell_of_ray.size(); ++ray)
            if (cell_of_ray[ray] < kCells) rays_[next[cell_of_ray[ray]]++] = ray;
    }
    /// Calls visit(ray) for the rays within about a degree of a direction.
    template <class Visit>
    void visit_near(const glm::vec3& direction, const Visit& visit) const {
        const auto cell = int(find_cell(direction)), row = cell / kColumns, column = cell % kColumns;
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, kRows - 1); ++r)
            for (int c = column - 1; c <= column + 1; ++c) {
                const std::size_t near = std::size_t(r * kColumns + (c + kColumns) % kColumns);
                for (std::uint32_t i = first_[near]; i < first_[near + 1]; ++i) visit(rays_[i]);
            }
    }

private:
    static constexpr int kRows = 180, kColumns = 360;
    static constexpr std::uint32_t kCells = kRows * kColumns;
    std::vector<std::uint32_t> first_, rays_;

    static std::uint32_t find_cell(const glm::vec3& direction) {
        const std::size_t fine = BodyTable::cell_of(direction);
        constexpr std::size_t kFineColumns = BodyTable::kColumns;
        return std::uint32_t(fine / kFineColumns / 2 * kColumns + fine % kFineColumns / 2);
    }
};

enum class PointSight { unknown, through, solid };

/// Returns whether the rays of another sweep pass through a point or end there.
PointSight view_point(const Log& log, const SensorPlace& from, const RaysByDirection& rays,
                      const glm::dvec3& point_m) {
    const Frame& frame = *from.frame;
    const Pose& mounting = log.lidar_of(frame).vehicle_from_sensor;
    const auto to_sensor = [&](double time_s) {
        return inverse(log.world_from_vehicle.mounted_pose_at(time_s, mounting)) * point_m;
    };
    // The sensor moves during the sweep, so this uses its pose when it faces the point.
    const glm::dvec3 in_sensor_m = to_sensor(facing_time_s(log, to_sensor(frame.time_s), timing_of(frame)));
    const double distance_m = glm::length(in_sensor_m);
    const double beside_m = 0.05 + 0.005 * distance_m;
    PointSight sight = PointSight::unknown;
    rays.visit_near(glm::vec3(in_sensor_m / distance_m), [&](std::uint32_t ray) {
        const glm::dvec3 direction(frame.scan.rays.direction[ray]),
            to_point_m = in_sensor_m - glm::dvec3(frame.scan.rays.origin[ray]);
        if (glm::length(glm::cross(direction, to_point_m)) > beside_m) return;
        const double range_m = frame.scan.range_m[ray], along_m = glm::dot(direction, to_point_m);
        const bool is_behind = range_m > std::max(kMinBehind * along_m, along_m + kMinBehind_m);
        if (is_behind && sight == PointSight::unknown) sight = PointSight::through;
        if (!is_behind && range_m > along_m / kMinBehind) sight = PointSight::solid;
    });
    return sight;
}

/// Returns for each place the places that could see through its points.
std::map<std::size_t, std::vector<std::size_t>> list_witnesses(const std::vector<SensorPlace>& places,
                                                               const std::vector<std::size_t>& chosen) {
    std::map<std::size_t, std::vector<std::size_t>> seen_by;  // key: the place that sees
    for (const std::size_t place : chosen)
        for (const int step : {-1, 1}) {
            auto other = std::ptrdiff_t(place);
            for (const double distance_m : kWitness_m) {
                const auto is_inside = [&] { return other >= 0 && other < std::ssize(places); };
                while (is_inside() && glm::distance(places[std::size_t(other)].position_m,
                                                    places[place].position_m) < distance_m)
                    other += step;
                if (!is_inside()) break;
                std::vector<std::size_t>& seen = seen_by[std::size_t(other)];
                if (seen.empty() || seen.back() != place) seen.push_back(place);
            }
        }
    return seen_by;
}

/// Numbers of views of the points in a cell from other places.
struct CellVotes {
    std::uint32_t through = 0, solid = 0;
};

std::vector<CellVotes> count_cell_votes(const Log& log, const std::vector<SensorPlace>& places,
                                        const std::vector<std::size_t>& chosen,
                                        const std::vector<NearReturn>& constant) {
    std::map<std::size_t, std::vector<NearReturn>> voters_of;  // key: place
    const std::size_t step = 1 + constant.size() / kMostVoters;
    for (std::size_t i = 0; i < constant.size(); i += step)
        voters_of[constant[i].place].push_back(constant[i]);
    const auto witnesses = list_witnesses(places, chosen);
    const std::vector<std::pair<std::size_t, std::vector<std::size_t>>> tasks(witnesses.begin(),
                                                                              witnesses.end());
    std::vector<CellVotes> votes(BodyTable::kCells);
    parallel_for(int(tasks.size()), [&](int task) {
        const auto& [from, seen] = tasks[std::size_t(task)];
        const RaysByDirection rays(places[from].frame->scan);
        for (const std::size_t place : seen) {
            const double moved_m = glm::distance(places[from].position_m, places[place].position_m);
            if (moved_m > kMaxView_m || !voters_of.contains(place)) continue;
            for (const NearReturn& hit : voters_of.at(place)) {
                if (moved_m < kMinRanges * double(hit.range_m)) continue;
                const glm::dvec3 point_m = locate_return(log, *places[place].frame, hit.ray).point_m;
                const PointSight sight = view_point(log, places[from], rays, point_m);
                CellVotes& cell = votes[hit.cell];
                if (sight == PointSight::through)
                    std::atomic_ref(cell.through).fetch_add(1, std::memory_order_relaxed);
                if (sight == PointSight::solid)
                    std::atomic_ref(cell.solid).fetch_add(1, std::memory_order_relaxed);
            }
        }
    });
    return votes;
}

/// Removes the cells that rays from other places do not pass through. Cells that few
/// returned rays have seen, for example in front of the sky, stay if they continue a cell
/// that rays pass through.
void remove_scenery(BodyTable& table, const std::vector<CellVotes>& votes) {
    const auto is_same_surface = [&](std::size_t cell, std::size_t near) {
        const float range_m = table.range_m[cell];
        return std::abs(table.range_m[near] - range_m) <= body_tolerance_m(range_m);
    };
    std::vector<bool> is_unsure(BodyTable::kCells), is_body(BodyTable::kCells);
    std::vector<std::size_t> body;
    for (std::size_t cell = 0; cell < BodyTable::kCells; ++cell) {
        if (!(table.range_m[cell] > 0.0f)) continue;
        CellVotes sum;
        visit_window(cell, kVoteWindow, [&](std::size_t near) {
            if (!is_same_surface(cell, near)) return;
            sum.through += votes[near].through;
            sum.solid += votes[near].solid;
        });
        is_unsure[cell] = sum.through + sum.solid < kMinVotes;
        is_body[cell] = !is_unsure[cell] && sum.through >= kMinThroughShare * (sum.through + sum.solid);
        if (is_body[cell]) body.push_back(cell);
    }
    for (std::size_t i = 0; i < body.size(); ++i)
        visit_window(body[i], kFillRows, [&](std::size_t near) {
            if (!is_unsure[near] || is_body[near] || !is_same_surface(body[i], near)) return;
            is_body[near] = true;
            body.push_back(near);
        });
    for (std::size_t cell = 0; cell < BodyTable::kCells; ++cell)
        if (!is_body[cell]) table.range_m[cell] = 0.0f;
}

/// Copies the nearest cell with rays to cells without rays, first along rows, then along
/// columns. A sensor can have few beams, and another sensor uses the table, too.
void fill_cells(BodyTable& table, std::vector<std::uint32_t> n_rays) {
    const auto fill = [&](int n_steps, int row_step, int column_step) {
        const BodyTable from = table;
        const std::vector<std::uint32_t> had_rays = n_rays;
        for (std::size_t cell = 0; cell < BodyTable::kCells; ++cell) {
            const int row = int(cell) / BodyTable::kColumns, column = int(cell) % BodyTable::kColumns;
            for (int k = 1; k <= n_steps && n_rays[cell] == 0; ++k)
                for (const int step : {-k, k}) {
                    const int near_row = row + step * row_step;
                    if (near_row < 0 || near_row >= BodyTable::kRows) continue;
                    const std::size_t near = wrapped_cell(near_row, column + step * column_step);
                    if (had_rays[near] == 0 || n_rays[cell] > 0) continue;
                    n_rays[cell] = had_rays[near];
                    table.range_m[cell] = from.range_m[near];
                    table.intensity[cell] = from.intensity[near];
                }
        }
    };
    fill(kFillColumns, 0, 1);
    fill(kFillRows, 1, 0);
}

/// Removes connected groups of few cells.
void remove_specks(BodyTable& table) {
    std::vector<bool> is_visited(BodyTable::kCells, false);
    for (std::size_t start = 0; start < BodyTable::kCells; ++start) {
        if (!(table.range_m[start] > 0.0f) || is_visited[start]) continue;
        std::vector<std::size_t> group{start};
        is_visited[start] = true;
        for (std::size_t i = 0; i < group.size(); ++i)
            visit_window(group[i], 1, [&](std::size_t near) {
                if (is_visited[near] || !(table.range_m[near] > 0.0f)) return;
                is_visited[near] = true;
                group.push_back(near);
            });
        if (group.size() >= kMinBodyCells) continue;
        for (const std::size_t cell : group) table.range_m[cell] = 0.0f;
    }
}

}  // namespace

std::size_t BodyTable::cell_of(const glm::vec3& direction) {
    const double elevation = std::asin(std::clamp(double(direction.z), -1.0, 1.0)),
                 azimuth = std::atan2(double(direction.y), double(direction.x));
    const int row = std::clamp(int((0.5 - elevation / kPi) * kRows), 0, kRows - 1),
              column = std::clamp(int((0.5 - 0.5 * azimuth / kPi) * kColumns), 0, kColumns - 1);
    return wrapped_cell(row, column);
}

glm::vec3 BodyTable::direction_of(std::size_t cell) {
    const double elevation = kPi * (0.5 - (double(cell / kColumns) + 0.5) / kRows),
                 azimuth = kPi * (1.0 - 2.0 * (double(cell % kColumns) + 0.5) / kColumns);
    return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
            std::sin(elevation)};
}

bool BodyTable::hides(const glm::vec3& direction, float measured_range_m) const {
    if (empty()) return false;
    float farthest_m = 0.0f;
    visit_window(cell_of(direction), 1,
                 [&](std::size_t near) { farthest_m = std::max(farthest_m, range_m[near]); });
    return farthest_m > 0.0f && measured_range_m <= farthest_m + body_tolerance_m(farthest_m);
}

std::string OwnBody::describe() const {
    std::array<bool, 360> is_body{};
    std::vector<float> ranges_m;
    for (std::size_t cell = 0; cell < table.range_m.size(); ++cell) {
        if (!(table.range_m[cell] > 0.0f)) continue;
        const glm::vec3 direction = BodyTable::direction_of(cell);
        const double degrees = std::atan2(direction.y, direction.x) * 180.0 / kPi;
        is_body[std::size_t(degrees + 360.0) % 360] = true;
        ranges_m.push_back(table.range_m[cell]);
    }
    std::ranges::sort(ranges_m);
    // The nearest and the farthest parts, without a few unusual cells.
    const std::string nearest = fmt::format("{:.1f}", ranges_m[ranges_m.size() / 20]),
                      farthest = fmt::format("{:.1f}", ranges_m[ranges_m.size() * 19 / 20]);
    const CircularGap gap = find_widest_gap(is_body.size(), [&](std::size_t b) { return is_body[b]; });
    const int first = int(gap.end % 360), last = first + 360 - int(gap.length);
    const int turn = last > 360 ? 360 : 0;
    return fmt::format(
        "{:.1f} % of the returns are on the body that carries the LiDAR: azimuth {} to {} degrees, {} m; "
        "they "
        "do not train the scene",
        100.0 * share, first - turn, last - turn,
        nearest == farthest ? nearest : nearest + " to " + farthest);
}

OwnBody find_own_body(const Log& log, int lidar, const std::vector<int>& frames) {
    const std::vector<SensorPlace> places = list_places(log, lidar, frames);
    const std::vector<std::size_t> chosen = choose_places(places.size());
    if (places.size() < kMinPlaces || !has_near_returns(places, chosen)) return {};
    const ReturnsByCell returns = collect_returns(places, chosen);
    OwnBody body;
    const std::vector<NearReturn> constant = find_constant(body.table, returns, places, chosen);
    remove_scenery(body.table, count_cell_votes(log, places, chosen, constant));
    fill_cells(body.table, returns.n_rays);
    remove_specks(body.table);
    const auto n_hidden = std::ranges::count_if(returns.near, [&](const NearReturn& hit) {
        return body.table.hides(places[hit.place].frame->scan.rays.direction[hit.ray], hit.range_m);
    });
    body.share = double(n_hidden) / double(returns.n_all_returns);
    return body.share >= kMinBodyShare ? body : OwnBody{};
}

void hide_own_body(Log& log, const std::vector<int>& frames) {
    parallel_for(int(frames.size()), [&](int index) {
        Frame& frame = log.frames[std::size_t(frames[std::size_t(index)])];
        const BodyTable& body = log.lidar_of(frame).own_body;
        Scan& scan = frame.scan;
        for (std::size_t ray = 0; ray < scan.range_m.size() && !body.empty(); ++ray) {
            const glm::vec3& direction = scan.rays.direction[ray];
            const bool is_hidden = scan.range_m[ray] > 0.0f && body.hides(direction, scan.range_m[ray]);
            if (is_hidden) {
                scan.range_m[ray] = scan.intensity[ray] = 0.0f;
                if (!scan.classes.empty()) scan.classes[ray] = SurfaceClass::unknown;
            }
            for (AdditionalReturns& second : scan.second_returns)
                if (is_hidden || body.hides(direction, second.range_m[ray]))
                    second.range_m[ray] = second.intensity[ray] = 0.0f;
        }
    });
}

}  // namespace relidar
