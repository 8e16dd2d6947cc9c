// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/log_body.hpp>

#include <algorithm>
#include <cmath>
#include <optional>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>

#include "base/parallel.hpp"

namespace relidar {
namespace {

// Beams show what is between them, but not what is farther above or below.
constexpr double kMaxBesideBeam_rad = 2.0 * kPi / 180.0;
// The distance of a body without returns is unknown. Nothing else can be nearer.
constexpr float kUnknownRange_m = 1e-3f;

/// Returns the number of the beam that is nearest to a direction, if one is near.
std::optional<std::uint16_t> find_nearest_beam(const std::vector<Beam>& beams, double elevation_rad) {
    const auto nearest = std::ranges::min_element(
        beams, {}, [&](const Beam& beam) { return std::abs(beam.elevation_rad - elevation_rad); });
    if (nearest == beams.end() || std::abs(nearest->elevation_rad - elevation_rad) > kMaxBesideBeam_rad)
        return std::nullopt;
    return std::uint16_t(nearest - beams.begin());
}

/// Returns true if the LiDAR of the log drops its rays in a direction.
bool is_blocked(const Run& run, int lidar, const glm::vec3& direction) {
    const std::vector<Beam>& beams = run.log.lidars[std::size_t(lidar)].sensor.beams;
    const auto nearest = find_nearest_beam(beams, std::asin(double(direction.z)));
    const auto beam = nearest ? run.log.find_global_beam(lidar, *nearest) : std::nullopt;
    return beam && run.scene.sensor_drop.probability_of(*beam, direction) >= kDropThreshold;
}

}  // namespace

VehicleBody find_log_body(const Run& run, int lidar, const Pose& lidar_from_sensor) {
    BodyTable seen = run.log.lidars[std::size_t(lidar)].own_body;
    if (seen.empty() && run.scene.sensor_drop.empty()) return {};
    seen.range_m.resize(BodyTable::kCells, 0.0f);
    seen.intensity.resize(BodyTable::kCells, 0.0f);
    parallel_blocks(BodyTable::kCells, [&](std::size_t cell) {
        if (seen.range_m[cell] > 0.0f || !is_blocked(run, lidar, BodyTable::direction_of(cell))) return;
        seen.range_m[cell] = kUnknownRange_m;
        seen.intensity[cell] = BodyTable::kNoReturn;
    });
    if (std::ranges::all_of(seen.range_m, [](float range_m) { return range_m == 0.0f; })) return {};
    return {.seen = std::move(seen), .seen_from_sensor = lidar_from_sensor.rotation};
}

}  // namespace relidar
